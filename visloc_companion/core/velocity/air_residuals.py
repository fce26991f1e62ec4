"""How far samples are from what is expected of them, and how alike neighbouring ones err: gusts last for seconds."""

from __future__ import annotations

import numpy as np

from visloc_companion.types import FloatArray

MEMORY = 60
"""Samples that the running means reach back over."""
MOST_ALIKE = 0.8
LONGEST_GAP_S = 2.0


class Residuals:
    """Of pairs, from 1-sigmas that are thought of them at first and that they have at least."""

    def __init__(self, start: float, least: float) -> None:
        self.n = 0
        self._square, self._least, self._alike = start**2, least**2, 0.0
        self._last: tuple[int, FloatArray] | None = None

    @property
    def variance(self) -> float:
        """Of one sample beside what the model expects, as if neighbouring ones were independent."""
        return self._square * (1 + self._alike) / (1 - self._alike)

    def since_s(self, t_ns: int) -> float:
        """Seconds since the last one, as far as they are counted."""
        return min(LONGEST_GAP_S, self.age_s(t_ns))

    def age_s(self, t_ns: int) -> float:
        """Seconds since the last one; zero before the first."""
        return 0.0 if self._last is None else max(0.0, (t_ns - self._last[0]) * 1e-9)

    def take(self, t_ns: int, residual: FloatArray, expected: float) -> None:
        """A residual (2,); `expected`: the part of its mean square that is no noise of its own."""
        self.n += 1
        share = max(1 / self.n, 1 / MEMORY)
        if self.n > 1:
            self._square += share * (max(float(residual @ residual) / 2 - expected, self._least) - self._square)
        if self._last is not None and t_ns - self._last[0] <= LONGEST_GAP_S * 1e9:
            alike = float(np.clip(residual @ self._last[1] / 2 / self._square, -1.0, 1.0))
            self._alike = float(np.clip(self._alike + share * (alike - self._alike), 0.0, MOST_ALIKE))
        self._last = (t_ns, residual)
