"""How fast this computer is just now, against how fast it is when nobody else uses it, or against a computer that is named.

CPU time grows where other processes share caches and memory. A fixed piece of work of the search's own kind, timed beside what is
measured, tells by how much. A computer is named by what the same piece of work takes there.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from visloc_companion.evaluate.demonstration.free_cores import search_field, search_work_s

LAST, FIRST = 7, 60


class Pace:
    """Times the fixed piece of work again and again; `quiet_s` is what it takes on the computer that times are stated for (None:
    this one when it is quiet, the least so far)."""

    def __init__(self, quiet_s: float | None = None) -> None:
        self._field = search_field()
        self._last: deque[float] = deque(maxlen=LAST)
        self._least_s = np.inf
        self._given_s = quiet_s
        for _ in range(FIRST):
            self.measure()

    @property
    def quiet_s(self) -> float:
        """CPU seconds of the piece of work on the computer that times are stated for."""
        return float(self._least_s) if self._given_s is None else self._given_s

    def measure(self) -> None:
        """Do the piece of work once."""
        took_s = search_work_s(self._field)
        self._least_s = min(self._least_s, took_s)
        self._last.append(took_s)

    def slower(self) -> float:
        """By what factor this computer is slower just now, over the last times: below 1 only than one that was named."""
        factor = float(np.median(self._last)) / self.quiet_s
        return max(1.0, factor) if self._given_s is None else factor
