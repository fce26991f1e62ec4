"""How many messages went lost, by the numbers that a sender gives them (modulo 256)."""

from __future__ import annotations

_NUMBERS, _LATE = 256, 240


class Numbers:
    """Of one sender. A number a little behind the newest is of a message that was overtaken, and no loss."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._came = self._missing = 0

    def take(self, number: int) -> None:
        """A message has arrived."""
        self._came += 1
        step = 1 if self._newest is None else (number - self._newest) % _NUMBERS
        if step >= _LATE:
            self._missing = max(0, self._missing - 1)
            return
        self._missing += max(0, step - 1)
        self._newest = number

    def lost_share(self, unknown: int) -> float:
        """Of all that was sent; `unknown` messages arrived, but are of kinds that were not read."""
        lost = max(0, self._missing - unknown)
        return lost / max(1, self._came + lost)
