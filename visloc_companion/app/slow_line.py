"""Tells the operator of a line to the autopilot that cannot carry all that is sent.

What is left out may be positions, answers to the autopilot's clock or texts: each is small, and only all together tell that the
line is too slow. A few that are left out at a start, where parameters are asked for, cost nothing.
"""

from __future__ import annotations

from visloc_companion.types import Notice, Severity

_NS_PER_S = 1_000_000_000
FORGOTTEN_NS = 10 * _NS_PER_S
"""So long after the latest message that was left out the line counts as quick enough again."""
LASTS_NS = 2 * _NS_PER_S
AGAIN_NS = 60 * _NS_PER_S
"""The text itself may be left out."""


class SlowLine:
    """Looks now and then at how many messages were left out since the start; times on any clock that does not go back."""

    def __init__(self) -> None:
        self.slow = False
        """Whether messages are being left out, time and again."""
        self._before = 0
        self._since_ns = self._last_ns = -FORGOTTEN_NS
        self._told_ns: int | None = None

    def seen(self, left_out: int, now_ns: int) -> Notice | None:
        """What the operator is to be told now, where anything is."""
        if left_out > self._before:
            if now_ns - self._last_ns >= FORGOTTEN_NS:
                self._since_ns = now_ns
            self._before, self._last_ns = left_out, now_ns
        lately = now_ns - self._last_ns < FORGOTTEN_NS
        self.slow = lately and self._last_ns - self._since_ns >= LASTS_NS
        if not self.slow or (self._told_ns is not None and now_ns - self._told_ns < AGAIN_NS):
            return None
        self._told_ns = now_ns
        return Notice(Severity.WARNING, "visloc: link too slow, messages left out", True, (("left_out", float(left_out)),))
