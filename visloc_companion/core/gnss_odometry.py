"""Odometry against GNSS: a drag moves GNSS in a way that the camera does not see, a step moves it at once.

Displacements of both over the same interval are compared: their rate of disagreement (m/s) shows a drag, their sum (m) a step.
Neither needs the map, so both work over water or off the map. The odometry must not come from the autopilot's filter, which
follows GNSS.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.shift import ShiftModel, ShiftTest
from visloc_companion.types import Vec2

BLOCK_S = 2.0
GAP_S = 1.0
"""Longer holes between two intervals begin anew."""
GNSS_WHITE_M = 0.3
ODOMETRY_S = 20.0
"""Errors of odometry (scale, heading, height) last for so long."""
RATES_MPS = (0.3, 1.0, 3.0)
STEPS_M = (10.0, 100.0)
MIN_RATE_SIGMA_MPS = 0.05
RATE = ShiftModel(0.05, 0.002, 0.05, 100.0, ODOMETRY_S, RATES_MPS)


class OdometryTest:
    """Two sequential tests of GNSS against odometry; `log_r` is that of both together."""

    def __init__(self) -> None:
        self._rate = ShiftTest(RATE, 2)
        self._to_ns: int | None = None
        self._restart()

    def _restart(self) -> None:
        self._sum = np.zeros(2)
        self._clear_block()
        self._place: ShiftTest | None = None

    def _clear_block(self) -> None:
        self._north = self._east = self._var = self._span_s = 0.0

    @property
    def log_r(self) -> float:
        """The two tests' statistics, summed; minus infinity before the first block."""
        place = -math.inf if self._place is None else self._place.log_r
        return float(np.logaddexp(self._rate.log_r, place))

    def forget(self) -> None:
        """Begin anew (trust was lost, or a probation starts)."""
        self._rate = self._rate.fork()
        self._restart()

    def add(self, t_from_ns: int, t_to_ns: int, difference_ne_m: Vec2, var_m2: float) -> None:
        """Take GNSS displacement minus that of odometry over an interval; `var_m2` is what odometry claims, per axis."""
        if self._to_ns is not None and not -0.5 * GAP_S <= (t_from_ns - self._to_ns) * 1e-9 <= GAP_S:
            self._restart()
        self._to_ns = t_to_ns
        self._north += difference_ne_m[0]
        self._east += difference_ne_m[1]
        self._var += var_m2
        self._span_s += (t_to_ns - t_from_ns) * 1e-9
        if self._span_s >= BLOCK_S:
            self._finish(t_to_ns * 1e-9)
            self._clear_block()

    def _finish(self, t_s: float) -> None:
        """The claimed variances are summed as if independent; errors that last are the quick part, no smaller than a floor."""
        moved, span_s = np.array([self._north, self._east]), self._span_s
        rate_var = max(self._var / span_s**2, MIN_RATE_SIGMA_MPS**2)
        self._rate.update(t_s, moved / span_s, 2 * (GNSS_WHITE_M / span_s) ** 2, rate_var)
        self._sum = self._sum + moved
        if self._place is None:
            walk = math.sqrt(2 * ODOMETRY_S * rate_var)
            self._place = ShiftTest(ShiftModel(GNSS_WHITE_M, walk, GNSS_WHITE_M, 100.0, ODOMETRY_S, STEPS_M), 2)
        self._place.update(t_s, self._sum, GNSS_WHITE_M**2, 0.0)
