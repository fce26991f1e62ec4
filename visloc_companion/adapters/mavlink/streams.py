"""Message rates: asked for, verified by counting what arrives, and asked for again.

ArduPilot acknowledges a rate before it is ready and then forgets it; ArduPlane denies more than 0.8 of its loop rate (50 Hz).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from visloc_companion.adapters.mavlink.commands import Answer, CommandQueue, Question
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.types import RequestMessage

_NS_PER_S = 1_000_000_000
_ENOUGH = 0.7
_MISSING_AFTER = 3
_PAUSES_S = (0.0, 1.0, 2.0, 4.0, 8.0)
"""Before it is asked for again after so many failures; the last one from then on."""
_NEEDS_POSITION = frozenset((mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED,))
_FIRST_STEP_DOWN, _STEP_DOWN, _SLOWEST_HZ = 0.75, 0.5, 0.5


class StreamState(StrEnum):
    """Whether a message that was asked for arrives."""

    PENDING = "pending"
    ARRIVING = "arriving"
    MISSING = "missing"


@dataclass(slots=True)
class _Stream:
    wanted: RequestMessage
    asked_hz: float
    state: StreamState = StreamState.PENDING
    due_ns: int | None = 0
    window_from_ns: int | None = None
    count: int = 0
    failures: int = 0


class StreamKeeper:
    """Sans-IO keeper of all wanted streams; `warnings` collects what an operator may want to know.

    While the autopilot has no origin (`has_origin`), or says that it has lost its position (`has_position`), ArduPilot sends no
    local position, and nobody is warned of that.
    """

    def __init__(self, queue: CommandQueue, window_s: float) -> None:
        self.has_origin, self.has_position = False, True
        self.warnings: list[str] = []
        self._queue = queue
        self._window_s = window_s
        self._streams: dict[int, _Stream] = {}

    def want(self, wanted: RequestMessage, now_ns: int) -> None:
        """Keep a stream at a rate; 0 Hz asks once. The same wish again changes nothing while it is being seen to."""
        known = self._streams.get(wanted.message_id)
        if known is None or known.wanted != wanted or known.state is StreamState.MISSING or wanted.rate_hz == 0:
            self._streams[wanted.message_id] = _Stream(wanted, wanted.rate_hz, due_ns=now_ns)

    def state(self, message_id: int) -> StreamState:
        """MISSING for what nobody asked for, and for what arrives at less than 0.7 of the wanted rate."""
        stream = self._streams.get(message_id)
        if stream is None:
            return StreamState.MISSING
        slow = stream.asked_hz < _ENOUGH * stream.wanted.rate_hz
        return StreamState.MISSING if slow and stream.state is StreamState.ARRIVING else stream.state

    def restart(self, now_ns: int) -> None:
        """The autopilot came (back): ask for everything anew."""
        for message_id, stream in self._streams.items():
            if stream.wanted.rate_hz > 0 or stream.state is StreamState.PENDING:
                self._streams[message_id] = _Stream(stream.wanted, stream.wanted.rate_hz, due_ns=now_ns)

    def arrived(self, message_id: int) -> None:
        """Count a message."""
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.count += 1
            if stream.wanted.rate_hz == 0:
                stream.state, stream.due_ns, stream.window_from_ns = StreamState.ARRIVING, None, None

    def poll(self, now_ns: int) -> None:
        """Ask for what is due and judge what has been counted long enough."""
        for message_id, stream in self._streams.items():
            if stream.due_ns is not None and now_ns >= stream.due_ns:
                stream.due_ns = None
                self._queue.ask(_question(message_id, stream.asked_hz))
            elif stream.window_from_ns is not None:
                self._judge(stream, now_ns)

    def answered(self, answer: Answer, now_ns: int) -> bool:
        """Take the answer to one of our questions; False where it is somebody else's."""
        owner, _, number = answer.question.key.partition(":")
        stream = self._streams.get(int(number)) if owner == "stream" else None
        if stream is None:
            return owner == "stream"
        if answer.result in (mav.MAV_RESULT_ACCEPTED, None):
            if stream.state is not StreamState.ARRIVING or stream.wanted.rate_hz > 0:
                stream.window_from_ns, stream.count = now_ns, 0
        elif answer.result == mav.MAV_RESULT_DENIED and stream.asked_hz > _SLOWEST_HZ:
            self._step_down(stream, now_ns)
        else:
            stream.failures = max(stream.failures, _MISSING_AFTER - 1)
            self._failed(stream, f"is refused (MAV_RESULT {answer.result})", now_ns)
        return True

    def _judge(self, stream: _Stream, now_ns: int) -> None:
        rate_hz = stream.asked_hz
        window_s = max(self._window_s, 3.0 / rate_hz) if rate_hz > 0 else self._window_s
        elapsed_s = (now_ns - (stream.window_from_ns or 0)) / _NS_PER_S
        if elapsed_s < window_s:
            return
        got_hz = stream.count / elapsed_s
        if rate_hz > 0 and got_hz >= _ENOUGH * rate_hz:
            stream.state, stream.failures = StreamState.ARRIVING, 0
            stream.window_from_ns, stream.count = now_ns, 0
        else:
            seldom = f"arrives at {got_hz:.1f} Hz instead of {rate_hz:g} Hz"
            self._failed(stream, seldom if rate_hz > 0 else "was asked for and does not come", now_ns)

    def _failed(self, stream: _Stream, why: str, now_ns: int) -> None:
        stream.failures += 1
        stream.window_from_ns = None
        pause_s = _PAUSES_S[min(stream.failures, len(_PAUSES_S)) - 1]
        stream.due_ns = now_ns + round(pause_s * _NS_PER_S)
        if stream.wanted.message_id in _NEEDS_POSITION and not (self.has_origin and self.has_position):
            stream.failures = min(stream.failures, _MISSING_AFTER - 1)
        if stream.failures == _MISSING_AFTER:
            self.warnings.append(f"{_name(stream.wanted.message_id)} {why}")
        stream.state = StreamState.MISSING if stream.failures >= _MISSING_AFTER else StreamState.PENDING

    def _step_down(self, stream: _Stream, now_ns: int) -> None:
        first = stream.asked_hz == stream.wanted.rate_hz
        slower_hz = stream.asked_hz * (_FIRST_STEP_DOWN if first else _STEP_DOWN)
        name = _name(stream.wanted.message_id)
        self.warnings.append(f"the autopilot denies {name} at {stream.asked_hz:g} Hz, asking for {slower_hz:g} Hz")
        stream.asked_hz, stream.due_ns = slower_hz, now_ns


def _question(message_id: int, rate_hz: float) -> Question:
    key = f"stream:{message_id}"
    if rate_hz == 0:
        return Question(key, mav.MAV_CMD_REQUEST_MESSAGE, (float(message_id),))
    return Question(key, mav.MAV_CMD_SET_MESSAGE_INTERVAL, (float(message_id), float(round(1e6 / rate_hz))))


def _name(message_id: int) -> str:
    known = mav.mavlink_map.get(message_id)
    return f"message {message_id}" if known is None else str(known.msgname)
