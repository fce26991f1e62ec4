"""The conversation with one autopilot, without any I/O: bytes in, events and bytes out, time as an argument.

A shell calls `receive` with what arrived and `poll` about every 50 ms, and after each call sends `packets()`. Nothing here raises
for what comes over the link.
"""

from __future__ import annotations

from collections import Counter, deque

from visloc_companion.adapters.mavlink.codec import examine, is_autopilot
from visloc_companion.adapters.mavlink.commands import Answer, CommandQueue, Question
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.encode import statustext, vision_position_estimate
from visloc_companion.adapters.mavlink.framing import FrameCounts, Framer
from visloc_companion.adapters.mavlink.link_state import LinkState
from visloc_companion.adapters.mavlink.outbox import Outbox
from visloc_companion.adapters.mavlink.settings import CompanionState, SessionSettings
from visloc_companion.adapters.mavlink.streams import StreamKeeper, StreamState
from visloc_companion.adapters.mavlink.switching import SourceSwitcher
from visloc_companion.adapters.mavlink.timesync import Timesync
from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    Event,
    GeoPoint,
    Injection,
    LinkChanged,
    LocalPose,
    Notice,
    OriginChanged,
    PriorPose,
    RequestMessage,
    SourceSwitched,
    SwitchSource,
)

_NS_PER_S = 1_000_000_000
_ACTIVE_FOR_NS = 2 * _NS_PER_S
_REBOOT_NS = 5 * _NS_PER_S
_STALL_NS = _NS_PER_S // 2
_VERSION_TRIES = 5
_MAX_WARNINGS = 50
_GARBAGE_BYTES = 64
"""So many bytes that are no message, and one more for each message, are worth a warning: ArduPilot prints some when it boots."""
_REFUSAL_TEXTS = {
    Reason.NO_ORIGIN: "no injection: the autopilot's EKF origin is not known",
    Reason.NOT_FINITE: "no injection: it holds a number that is not finite",
    Reason.BAD_INPUT: "no injection: it lies outside what the message can carry",
    Reason.IMPLAUSIBLE_TIME: "no injection: its time goes backwards",
}


class MavlinkSession:
    """Pins to one autopilot, keeps its streams, answers its clock, carries injections and switches.

    `poll` at least twice a second: a longer pause is taken for a stall of our own and not held against the autopilot.

    Pinning: the first HEARTBEAT of an autopilot (component 1) fixes the system id for good, or the settings name it. What
    another system says is ignored; a second autopilot is warned of once. Time that goes backwards is held at its latest.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.settings = settings
        self.dropped: Counter[tuple[str, Reason]] = Counter()
        self.refused: Counter[Reason] = Counter()
        self._framer = Framer()
        self._link = LinkState()
        self._outbox = Outbox(settings.component_id)
        self._queue = CommandQueue(settings.ack_timeout_s, settings.component_id)
        self._streams = StreamKeeper(self._queue, settings.window_s)
        self._switcher = SourceSwitcher(self._queue, settings)
        self._timesync = Timesync()
        self._state: CompanionState | None = None
        self._pinned = settings.system_id
        self._strangers: set[int] = set()
        self._warnings: deque[str] = deque(maxlen=_MAX_WARNINGS)
        self._pending: list[Event] = []
        self._now_ns = 0
        self._heard_ns = 0
        self._n_heard = 0
        self._polled_ns = 0
        self._boot_ns = 0
        self._attitude_boot_ns = -1
        self._garbage_told = False
        self._origin: GeoPoint | None = None
        self._last_injection_ns = -_ACTIVE_FOR_NS
        self._next_heartbeat_ns = 0
        self._next_timesync_ns = 0
        self._next_origin_ns = 0
        self._next_version_ns = 0
        self._version_tries = 0
        if self._pinned:
            self._outbox.speak_as(self._pinned)

    # ------------------------------------------------------------------------------------------------------------ what is known

    @property
    def link(self) -> LinkChanged:
        """The autopilot as far as it is known; `up` tells whether it is heard."""
        return self._link.known

    @property
    def origin(self) -> GeoPoint | None:
        """The autopilot's EKF origin, None while it is not known (then nothing is injected)."""
        return self._origin

    @property
    def n_heard(self) -> int:
        """How many messages the autopilot has sent so far."""
        return self._n_heard

    @property
    def counts(self) -> FrameCounts:
        """Messages, unknown messages and garbage bytes so far."""
        return self._framer.counts

    def stream_state(self, message_id: int) -> StreamState:
        """Whether a requested message arrives at about the rate that was asked for."""
        return self._streams.state(message_id)

    def warnings(self) -> list[str]:
        """What the operator may want to know since the last call; forgotten by the call."""
        self._warnings.extend(self._streams.warnings)
        self._streams.warnings.clear()
        drained = list(self._warnings)
        self._warnings.clear()
        return drained

    # ------------------------------------------------------------------------------------------------------------ in

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """Take bytes from the link; the events in them, stamped `now_ns`. Any bytes, in any pieces."""
        now_ns = self._advance(now_ns)
        for msg in self._framer.feed(data):
            self._take(msg, now_ns)
        counts = self._framer.counts
        if not self._garbage_told and counts.garbage_bytes >= _GARBAGE_BYTES + counts.messages:
            self._garbage_told = True
            self._warn("bytes on the link are not MAVLink (wrong baud rate, noise, or another protocol?); they are skipped")
        return self._drain_events()

    def poll(self, now_ns: int) -> list[Event]:
        """What time brings: heartbeat, own TIMESYNC requests, requests that are due, the silence of the autopilot."""
        now_ns = self._advance(now_ns)
        if now_ns - self._polled_ns > _STALL_NS:
            self._heard_ns += now_ns - self._polled_ns  # we were away ourselves: what came meanwhile is not read yet
        self._polled_ns = now_ns
        if self.link.up and now_ns - self._heard_ns > self.settings.timeout_s * _NS_PER_S:
            self._lose(f"the autopilot is silent for {self.settings.timeout_s:g} s", now_ns)
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + round(self.settings.heartbeat_s * _NS_PER_S)
            self._heartbeat(now_ns)
        if self.link.up:
            self._ask_what_is_due(now_ns)
        return self._drain_events()

    # ------------------------------------------------------------------------------------------------------------ out

    def packets(self) -> list[bytes]:
        """The packets to be sent now, oldest first; forgotten by the call."""
        return self._outbox.drain()

    def outgoing(self) -> bytes:
        """The same as one string of bytes."""
        return b"".join(self._outbox.drain())

    def send(self, injection: Injection, now_ns: int) -> bool:
        """Queue a VISION_POSITION_ESTIMATE; False, with a count and one warning a reason, where it must not be sent."""
        self._advance(now_ns)
        if not self.link.up:
            return False
        message = vision_position_estimate(injection, self.link.autopilot)
        refusal = message if isinstance(message, Reason) else self._refusal(injection)
        if refusal is not None:
            if not self.refused[refusal]:
                self._warn(_REFUSAL_TEXTS[refusal])
            self.refused[refusal] += 1
            return False
        self._last_injection_ns = injection.t_ns
        self._outbox.put(message)
        return True

    def disconnected(self, why: str, now_ns: int) -> list[Event]:
        """The connection is gone: the link is down at once, not after its silence."""
        now_ns = self._advance(now_ns)
        if self.link.up:
            self._lose(why, now_ns)
        else:
            self._warn(why)
        return self._drain_events()

    def request(self, message: RequestMessage, now_ns: int) -> None:
        """Keep a message coming at a rate (0 Hz: once). `stream_state` tells how it goes."""
        self._streams.want(message, self._advance(now_ns))

    def switch(self, source: SwitchSource, now_ns: int) -> None:
        """Switch the position source; the end comes as a SourceSwitched event."""
        now_ns = self._advance(now_ns)
        self._ended(self._switcher.start(source.source, self.link, now_ns))

    def notify(self, notice: Notice, now_ns: int) -> None:
        """Queue a STATUSTEXT where the notice is for the operator."""
        self._advance(now_ns)
        if notice.to_operator:
            self._outbox.put(statustext(notice))

    def set_state(self, state: CompanionState | None) -> None:
        """The state that the heartbeat shows; None (as at first) shows ACTIVE while injections flow and else STANDBY."""
        self._state = state

    # ------------------------------------------------------------------------------------------------------------ inside

    def _advance(self, now_ns: int) -> int:
        self._now_ns = max(self._now_ns, now_ns)
        return self._now_ns

    def _drain_events(self) -> list[Event]:
        events, self._pending = self._pending, []
        return events

    def _warn(self, text: str) -> None:
        self._warnings.append(text)

    def _take(self, msg: Message, now_ns: int) -> None:
        if msg.get_srcComponent() != AUTOPILOT_COMPONENT or not self._is_pinned(msg):
            return
        self._heard_ns = now_ns
        self._n_heard += 1
        kind = msg.get_type()
        if not self.link.up and kind != "HEARTBEAT":
            return
        self._streams.arrived(msg.get_msgId())
        if kind == "TIMESYNC":
            self._take_timesync(msg, now_ns)
        elif kind == "COMMAND_ACK":
            answer = self._queue.acknowledged(msg, self._pinned, now_ns)
            if answer is not None:
                self._answered(answer, now_ns)
        elif kind == "PARAM_VALUE":
            self._ended(self._switcher.param_value(msg, now_ns))
        else:
            self._take_event(msg, now_ns)

    def _is_pinned(self, msg: Message) -> bool:
        system_id = msg.get_srcSystem()
        pilot = msg.get_type() == "HEARTBEAT" and is_autopilot(msg)
        if pilot and self._pinned == 0 and system_id != 0:
            self._pinned = system_id
            self._outbox.speak_as(system_id)
        if pilot and system_id != self._pinned and system_id not in self._strangers:
            self._strangers.add(system_id)
            self._warn(f"a second autopilot (system {system_id}) is on the link and is ignored; listening to {self._pinned}")
        return bool(system_id == self._pinned and self._pinned)

    def _take_timesync(self, msg: Message, now_ns: int) -> None:
        reply, sample = self._timesync.take(msg, now_ns)
        if reply is not None:
            self._outbox.put(reply)
        if sample is not None:
            self._pending.append(sample)

    def _take_event(self, msg: Message, now_ns: int) -> None:
        outcome = examine(msg, now_ns)
        if isinstance(outcome, Reason):
            self.dropped[msg.get_type(), outcome] += 1
        elif isinstance(outcome, LinkChanged):
            self._take_link(outcome, now_ns)
        elif isinstance(outcome, OriginChanged):
            if outcome.origin != self._origin:
                self._origin = outcome.origin
                self._pending.append(outcome)
        elif outcome is not None and not self._is_said_twice(outcome):
            self._watch_boot_time(outcome, now_ns)
            self._pending.append(outcome)

    def _is_said_twice(self, event: Event) -> bool:
        """PX4 sends each attitude as ATTITUDE and as ATTITUDE_QUATERNION; one of both is enough."""
        if not isinstance(event, Attitude):
            return False
        repeated = event.t_boot_ns == self._attitude_boot_ns
        self._attitude_boot_ns = event.t_boot_ns
        return repeated

    def _take_link(self, event: LinkChanged, now_ns: int) -> None:
        was_up = self.link.up
        changed = self._link.heard(event)
        if changed is None:
            return
        self._pending.append(changed)
        if not was_up:
            self._boot_ns, self._version_tries = 0, 0
            self._next_origin_ns = self._next_version_ns = self._next_timesync_ns = now_ns
            self._streams.restart(now_ns)

    def _watch_boot_time(self, event: Event, now_ns: int) -> None:
        if isinstance(event, Attitude | LocalPose | PriorPose):
            if event.t_boot_ns < self._boot_ns - _REBOOT_NS:
                self._lose("the autopilot's clock went back: it was restarted", now_ns)
                self._boot_ns = event.t_boot_ns
            self._boot_ns = max(self._boot_ns, event.t_boot_ns)

    def _lose(self, why: str, now_ns: int) -> None:
        changed = self._link.down(now_ns)
        if changed is not None:
            self._warn(why)
            self._pending.append(changed)
        self._origin = None
        self._queue.clear()
        self._timesync.clear()
        self._ended(self._switcher.abandon(why, now_ns))

    def _heartbeat(self, now_ns: int) -> None:
        active = now_ns - self._last_injection_ns < _ACTIVE_FOR_NS
        state = self._state or (CompanionState.ACTIVE if active else CompanionState.STANDBY)
        kind, autopilot = mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID
        self._outbox.put(mav.MAVLink_heartbeat_message(kind, autopilot, 0, 0, int(state), 3))

    def _ask_what_is_due(self, now_ns: int) -> None:
        if now_ns >= self._next_timesync_ns:
            self._next_timesync_ns = now_ns + round(self.settings.timesync_s * _NS_PER_S)
            self._outbox.put(self._timesync.ask(now_ns))
        if now_ns >= self._next_version_ns and not self.link.version and self._version_tries < _VERSION_TRIES:
            self._version_tries += 1
            self._next_version_ns = now_ns + 2**self._version_tries * _NS_PER_S
            self._ask_once("version", mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if now_ns >= self._next_origin_ns:
            pause_s = self.settings.origin_unknown_s if self._origin is None else self.settings.origin_known_s
            self._next_origin_ns = now_ns + round(pause_s * _NS_PER_S)
            self._ask_once("origin", mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        self._streams.has_origin = self._origin is not None
        self._streams.poll(now_ns)
        param_set, ended = self._switcher.poll(self._pinned, now_ns)
        self._ended(ended)
        command, given_up = self._queue.poll(self._pinned, now_ns)
        if given_up is not None:
            self._answered(given_up, now_ns)
        for message in (param_set, command):
            if message is not None:
                self._outbox.put(message)

    def _ask_once(self, key: str, message_id: int) -> None:
        if not self._queue.busy_with(key):
            self._queue.ask(Question(key, mav.MAV_CMD_REQUEST_MESSAGE, (float(message_id),)))

    def _answered(self, answer: Answer, now_ns: int) -> None:
        ended = self._switcher.answered(answer, now_ns)
        if ended is not None:
            self._ended(ended)
        else:
            self._streams.answered(answer, now_ns)

    def _ended(self, ended: list[SourceSwitched]) -> None:
        self._pending.extend(ended)

    def _refusal(self, injection: Injection) -> Reason | None:
        if self._origin is None:
            return Reason.NO_ORIGIN
        return Reason.IMPLAUSIBLE_TIME if injection.t_ns < self._last_injection_ns else None
