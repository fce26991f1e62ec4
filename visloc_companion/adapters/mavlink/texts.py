"""STATUSTEXT (253) for ground stations: long texts in pieces, no repeats, no floods.

Ground stations put the pieces of one text together by `id` and `chunk_seq`; a piece shorter than 50 characters is its last
(mavlink.io, STATUSTEXT). They show every text on a line of its own and speak the grave ones: a flood hides what matters.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.adapters.mavlink.encode import STATUSTEXT_LENGTH, statustext
from visloc_companion.types import Notice, Severity

MAX_LENGTH = 4 * STATUSTEXT_LENGTH
REPEAT_NS = 10_000_000_000
BURST = 8
_REFILL_NS = 1_000_000_000


class _Bucket:
    """Lets BURST texts through at once and one a second in the long run."""

    def __init__(self) -> None:
        self._full_at_ns = 0

    def take(self, now_ns: int) -> bool:
        """Whether one more may go."""
        full_at_ns = max(self._full_at_ns, now_ns) + _REFILL_NS
        if full_at_ns - now_ns > BURST * _REFILL_NS:
            return False
        self._full_at_ns = full_at_ns
        return True


class TextSender:
    """Sans-IO. The same text again within 10 s, with no other between, is not sent; nor is what exceeds 8 at once and one a
    second after. Critical ones have an allowance of their own. `held_back` counts by severity."""

    def __init__(self) -> None:
        self.held_back: Counter[Severity] = Counter()
        self._last: tuple[Severity, str] | None = None
        self._last_ns = 0
        self._plain, self._critical = _Bucket(), _Bucket()
        self._id = 0

    def asked(self) -> None:
        """Somebody waits for an answer: the next text is sent even if it repeats the last one."""
        self._last = None

    def messages(self, notice: Notice, now_ns: int) -> list[Message]:
        """What is to be sent for a notice: one message, several pieces, or nothing."""
        said = notice.severity, notice.text
        bucket = self._critical if notice.severity is Severity.CRITICAL else self._plain
        if (said == self._last and now_ns - self._last_ns < REPEAT_NS) or not bucket.take(now_ns):
            self.held_back[notice.severity] += 1
            return []
        self._last, self._last_ns = said, now_ns
        if len(notice.text) <= STATUSTEXT_LENGTH:
            return [statustext(notice)]
        self._id = self._id % 65535 + 1
        return _pieces(replace(notice, text=notice.text[:MAX_LENGTH]), self._id)


def _pieces(notice: Notice, number: int) -> list[Message]:
    """The last piece is shorter than the others, empty where need be: its end is how a receiver knows it."""
    starts = range(0, len(notice.text) + 1, STATUSTEXT_LENGTH)
    pieces = [statustext(replace(notice, text=notice.text[start : start + STATUSTEXT_LENGTH])) for start in starts]
    for sequence, piece in enumerate(pieces):
        piece.id, piece.chunk_seq = number, sequence
    return pieces
