"""Switching the autopilot's horizontal position source, confirmed by the autopilot.

ArduPilot: MAV_CMD_SET_EKF_SOURCE_SET (42007) with its COMMAND_ACK. PX4: the parameter EKF2_GPS_CTRL, 0 for vision and the
configured value for GNSS, with the PARAM_VALUE that comes back. The ACK of ArduPilot does not say that the source has data.
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.commands import Answer, CommandQueue, Question
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.encode import param_set_int32, parameter_value
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.types import AutopilotKind, EkfSource, LinkChanged, SourceSwitched

_NS_PER_S = 1_000_000_000
_KEY = "switch"
_TRIES = 3
_PARAM = "EKF2_GPS_CTRL"


class SourceSwitcher:
    """Sans-IO. At most one switch is under way; a new one supersedes it."""

    def __init__(self, queue: CommandQueue, settings: SessionSettings) -> None:
        self._queue = queue
        self._settings = settings
        self._retry_ns = round(settings.ack_timeout_s * _NS_PER_S)
        self._shows_use = True
        self._under_way: EkfSource | None = None
        self._param_value: int | None = None
        self._tries = 0
        self._next_ns = 0

    def start(self, source: EkfSource, link: LinkChanged, now_ns: int, *, shows_use: bool = True) -> list[SourceSwitched]:
        """Begin; the events are what ends at once (no link, unknown autopilot, an older switch that is superseded).

        `shows_use` goes into the event.
        """
        ended = self.abandon("superseded by a newer switch", now_ns)
        if not link.up:
            return [*ended, SourceSwitched(now_ns, source, False, "no link to the autopilot", answered=False)]
        if link.autopilot is AutopilotKind.UNKNOWN:
            return [*ended, SourceSwitched(now_ns, source, False, "this kind of autopilot has no known way to switch")]
        self._under_way, self._shows_use = source, shows_use
        vision = source is EkfSource.VISION
        if link.autopilot is AutopilotKind.PX4:
            self._param_value = 0 if vision else self._settings.px4_gps_ctrl
            self._tries, self._next_ns = 0, now_ns
        else:
            source_set = self._settings.vision_source_set if vision else self._settings.gnss_source_set
            command = mav.MAV_CMD_SET_EKF_SOURCE_SET
            self._queue.ask(Question(_KEY, command, (float(source_set),), tries=_TRIES, urgent=True))
        return ended

    def abandon(self, why: str, now_ns: int) -> list[SourceSwitched]:
        """End what is under way without success."""
        return self._end(False, why, now_ns, answered=False)

    def answered(self, answer: Answer, now_ns: int) -> list[SourceSwitched] | None:
        """Take ArduPilot's answer; None where the question was not ours."""
        if answer.question.key != _KEY:
            return None
        if answer.result is None:
            return self._end(False, f"no answer to {_TRIES} tries", now_ns, answered=False)
        accepted = answer.result == mav.MAV_RESULT_ACCEPTED
        return self._end(accepted, "" if accepted else f"refused with MAV_RESULT {answer.result}", now_ns)

    def param_value(self, msg: Message, now_ns: int) -> list[SourceSwitched]:
        """Take a PARAM_VALUE."""
        if self._param_value is None or msg.param_id.rstrip("\x00") != _PARAM:
            return []
        return self._end(True, "", now_ns) if parameter_value(msg, AutopilotKind.PX4) == self._param_value else []

    def poll(self, system_id: int, now_ns: int) -> tuple[Message | None, list[SourceSwitched]]:
        """The PARAM_SET to send now, if any, and the end of a switch that nobody confirmed."""
        if self._param_value is None or now_ns < self._next_ns:
            return None, []
        if self._tries >= _TRIES:
            return None, self._end(False, f"{_PARAM} was not confirmed after {_TRIES} tries", now_ns, answered=False)
        self._tries += 1
        self._next_ns = now_ns + self._retry_ns
        return param_set_int32(system_id, _PARAM, self._param_value), []

    def _end(self, accepted: bool, detail: str, now_ns: int, *, answered: bool = True) -> list[SourceSwitched]:
        if self._under_way is None:
            return []
        ended = SourceSwitched(now_ns, self._under_way, accepted, detail, self._shows_use, answered)
        self._under_way, self._param_value = None, None
        self._queue.withdraw(_KEY)
        return [ended]
