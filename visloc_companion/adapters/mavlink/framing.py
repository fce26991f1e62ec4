"""Bytes to messages: cuts a stream into checked MAVLink 1 and 2 frames.

pymavlink's own parser is not used on the live link for two reasons: a false start byte makes it swallow up to 280 bytes of good
messages, and its buffer is freed only when it happens to be empty, so that it grows without bound on a busy stream.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from visloc_companion.adapters.mavlink.dialect import Message, mav

_START = re.compile(b"[\xfd\xfe]")
_HEADER_V1, _HEADER_V2, _CHECKSUM, _SIGNATURE = 6, 10, 2, 13
MAX_FRAME = _HEADER_V2 + 255 + _CHECKSUM + _SIGNATURE
MAX_PENDING = 2 * MAX_FRAME


class _Verdict(Enum):
    GOOD = auto()
    UNKNOWN = auto()
    """Well formed, of an id that the dialect lacks: its checksum cannot be verified."""
    UNFINISHED = auto()
    FALSE = auto()


@dataclass(slots=True)
class FrameCounts:
    """What went through: good messages, well-formed frames of unknown id, and bytes that were no message."""

    messages: int = 0
    unknown: int = 0
    garbage_bytes: int = 0


class Framer:
    """Stateful and bounded: keeps less than two unfinished frames (MAX_PENDING bytes). Never raises for what bytes may hold.

    After a wrong checksum the search goes on at the byte behind the false start, so no good message is lost to it. A false
    start that still waits for its claimed length, or claims an unknown id, gives way where a whole good message lies in it.
    `admits` judges each good frame by its bytes and the id of its message (signing.SignatureGuard); what it refuses is skipped.
    """

    def __init__(self, admits: Callable[[bytearray, int], bool] | None = None) -> None:
        self.counts = FrameCounts()
        self._admits = admits
        self._buffer = bytearray()
        self._parser = mav.MAVLink(None)

    @property
    def pending_bytes(self) -> int:
        """Bytes kept for the next call."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are complete with these bytes, in order."""
        self._buffer += data
        messages: list[Message] = []
        at = 0
        while (start := self._next_start(at)) is not None:
            verdict, length, message = self._frame_at(start)
            if verdict is _Verdict.UNKNOWN:
                verdict = self._unknown_or_false(start, length)
            if verdict is _Verdict.GOOD:
                self.counts.messages += 1
                if message is not None and self._admitted(start, length, message):
                    messages.append(message)
                at = start + length
            elif verdict is _Verdict.UNKNOWN:
                self.counts.unknown += 1
                at = start + length
            elif verdict is _Verdict.UNFINISHED and _Verdict.GOOD not in self._verdicts_behind(start, len(self._buffer)):
                at = start
                break
            else:
                self.counts.garbage_bytes += 1
                at = start + 1
        else:
            at = len(self._buffer)
        del self._buffer[:at]
        return messages

    def _admitted(self, start: int, length: int, message: Message) -> bool:
        return self._admits is None or self._admits(self._buffer[start : start + length], message.get_msgId())

    def _next_start(self, at: int) -> int | None:
        found = _START.search(self._buffer, at)
        self.counts.garbage_bytes += (found.start() if found else len(self._buffer)) - at
        return found.start() if found else None

    def _frame_at(self, start: int) -> tuple[_Verdict, int, Message | None]:
        """What stands at a start byte: its verdict, its length, and the message where it is good."""
        frame = self._buffer[start : start + MAX_FRAME]
        if len(frame) < 3:
            return _Verdict.UNFINISHED, 0, None
        if frame[0] == mav.PROTOCOL_MARKER_V1:
            length = _HEADER_V1 + frame[1] + _CHECKSUM
        elif frame[2] & ~mav.MAVLINK_IFLAG_SIGNED:
            return _Verdict.FALSE, 0, None
        else:
            length = _HEADER_V2 + frame[1] + _CHECKSUM + _SIGNATURE * (frame[2] & mav.MAVLINK_IFLAG_SIGNED)
        if len(frame) < length:
            return _Verdict.UNFINISHED, 0, None
        try:
            message = self._parser.decode(frame[:length])
        except mav.MAVError:
            return _Verdict.FALSE, 0, None
        if message.get_msgId() >= 0:
            return _Verdict.GOOD, length, message
        return _Verdict.UNKNOWN, length, None

    def _unknown_or_false(self, start: int, length: int) -> _Verdict:
        """Nothing vouches for a frame of unknown id: it counts once another frame follows and none can begin inside it, or a good
        one follows and none lies inside."""
        if len(self._buffer) == start + length:
            return _Verdict.UNFINISHED
        if self._buffer[start + length] not in (mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2):
            return _Verdict.FALSE
        inside = self._verdicts_behind(start, start + length)
        if _Verdict.GOOD in inside:
            return _Verdict.FALSE
        doubtful = _Verdict.UNFINISHED in inside and self._frame_at(start + length)[0] is not _Verdict.GOOD
        return _Verdict.UNFINISHED if doubtful else _Verdict.UNKNOWN

    def _verdicts_behind(self, start: int, end: int) -> set[_Verdict]:
        return {self._frame_at(found.start())[0] for found in _START.finditer(self._buffer, start + 1, end)}
