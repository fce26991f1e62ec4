"""What a session asks and tells by the clock: its heartbeat, TIMESYNC, version and origin, message rates, commands."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.commands import Answer, CommandQueue, Question
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.encode import command_long, heartbeat
from visloc_companion.adapters.mavlink.origin_setting import OriginSetter
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.settings import CompanionState, SessionSettings
from visloc_companion.adapters.mavlink.streams import StreamKeeper
from visloc_companion.adapters.mavlink.switching import SourceSwitcher
from visloc_companion.adapters.mavlink.timesync import Timesync
from visloc_companion.types import AutopilotKind, Event, LinkChanged, SourceSwitched

_NS_PER_S = 1_000_000_000
_VERSION_TRIES = 5
_HEARTBEAT_AGAIN_NS = _NS_PER_S // 5
_STATUS_MESSAGES = {
    AutopilotKind.ARDUPILOT: mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    AutopilotKind.PX4: mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
}


class Upkeep:
    """Sans-IO. `streams` and `switcher` are the keepers of what goes through its one queue of commands."""

    def __init__(self, settings: SessionSettings, outbox: Outbox) -> None:
        self._settings = settings
        self._outbox = outbox
        self._queue = CommandQueue(settings.ack_timeout_s, settings.component_id)
        self.streams = StreamKeeper(self._queue, settings.window_s)
        self.switcher = SourceSwitcher(self._queue, settings)
        self._origin = OriginSetter(settings.origin_to_set)
        self._timesync = Timesync()
        self._next_heartbeat_ns = 0
        self._next_timesync_ns = 0
        self._next_origin_ns = 0
        self._next_version_ns = 0
        self._ask_heartbeat_ns = 0
        self._version_tries = 0
        self._status_due = False

    def restart(self, now_ns: int) -> None:
        """The autopilot came (back): everything is asked anew."""
        self._version_tries = 0
        self._status_due = True
        self._next_origin_ns = self._next_version_ns = self._next_timesync_ns = now_ns
        self._origin.restart(now_ns)
        self.streams.restart(now_ns)

    def forget(self, why: str, now_ns: int) -> list[SourceSwitched]:
        """The link is down: what was asked will not be answered."""
        self._queue.clear()
        self._timesync.clear()
        return self.switcher.abandon(why, now_ns)

    def heartbeat(self, state: CompanionState, now_ns: int) -> None:
        """Send HEARTBEAT where it is due."""
        if now_ns < self._next_heartbeat_ns:
            return
        self._next_heartbeat_ns = now_ns + round(self._settings.heartbeat_s * _NS_PER_S)
        self._outbox.put(heartbeat(int(state)))

    def ask_for_heartbeat(self, system_id: int, now_ns: int) -> None:
        """Ask an autopilot that speaks, and is not known to be there yet, for the HEARTBEAT that it sends once a second only.

        Not through the queue: it is answered by the HEARTBEAT, and what comes before that, as ArduPilot's ACK, is not heard.
        """
        if now_ns >= self._ask_heartbeat_ns:
            self._ask_heartbeat_ns = now_ns + _HEARTBEAT_AGAIN_NS
            asked = float(mav.MAVLINK_MSG_ID_HEARTBEAT)
            self._outbox.put(command_long(system_id, mav.MAV_CMD_REQUEST_MESSAGE, asked))

    def doubt_origin(self, now_ns: int) -> None:
        """The autopilot seems to have another origin than it told: it is asked at once, even where it just was."""
        self._queue.withdraw("origin")
        self._next_origin_ns = now_ns

    def ask_what_is_due(
        self, link: LinkChanged, has_origin: bool, now_ns: int, *, sure_of_origin: bool = True
    ) -> list[SourceSwitched]:
        """Send what is due while the link is up; switches that ended for want of an answer."""
        if now_ns >= self._next_timesync_ns:
            self._next_timesync_ns = now_ns + round(self._settings.timesync_s * _NS_PER_S)
            self._outbox.put(self._timesync.ask(now_ns))
        if now_ns >= self._next_origin_ns:
            pause_s = self._settings.origin_known_s if has_origin and sure_of_origin else self._settings.origin_unknown_s
            self._next_origin_ns = now_ns + round(pause_s * _NS_PER_S)
            self._ask_once("origin", mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        if self._status_due and link.autopilot in _STATUS_MESSAGES:
            self._status_due = False  # its stream comes twice a second, and the navigator may wait for nothing else
            self._ask_once("status", _STATUS_MESSAGES[link.autopilot])
        if now_ns >= self._next_version_ns and not link.version and self._version_tries < _VERSION_TRIES:
            self._version_tries += 1
            self._next_version_ns = now_ns + 2**self._version_tries * _NS_PER_S
            self._ask_once("version", mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        self.streams.has_origin = has_origin
        self.streams.poll(now_ns)
        param_set, ended = self.switcher.poll(link.system_id, now_ns)
        command, given_up = self._queue.poll(link.system_id, now_ns)
        if given_up is not None:
            ended += self._answered(given_up, now_ns)
        for message in (self._origin.poll(link, has_origin, now_ns), param_set, command):
            if message is not None:
                self._outbox.put(message)
        return ended

    def take(self, msg: Message, system_id: int, now_ns: int) -> list[Event] | None:
        """The events of a message that answers (or asks) something; None for any other message."""
        self._origin.hear(msg, now_ns)
        match msg.get_type():
            case "TIMESYNC":
                reply, sample = self._timesync.take(msg, now_ns)
                if reply is not None:
                    self._outbox.put(reply)
                return [] if sample is None else [sample]
            case "COMMAND_ACK":
                answer = self._queue.acknowledged(msg, system_id, now_ns)
                return [] if answer is None else [*self._answered(answer, now_ns)]
            case "PARAM_VALUE":
                return [*self.switcher.param_value(msg, now_ns)]
            case _:
                return None

    def _ask_once(self, key: str, message_id: int) -> None:
        if not self._queue.busy_with(key):
            self._queue.ask(Question(key, mav.MAV_CMD_REQUEST_MESSAGE, (float(message_id),)))

    def _answered(self, answer: Answer, now_ns: int) -> list[SourceSwitched]:
        ended = self.switcher.answered(answer, now_ns)
        if ended is None:
            self.streams.answered(answer, now_ns)
        return ended or []
