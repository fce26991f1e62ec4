"""Odometry against GNSS: a drag moves GNSS in a way that the camera does not see, a step moves it at once.

Displacements of both over the same interval are compared: their rate of disagreement (m/s) shows a drag, their sum (m) a step.
Neither needs the map, so both work over water or off the map. The odometry must not come from the autopilot's filter, which
follows GNSS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.satellites.shift import ShiftModel, ShiftTest
from visloc_companion.types import Vec2

BLOCK_S = 2.0
GAP_S = 1.0
"""Longer holes between two intervals begin anew."""
ZOOM_SIGMAS = 3.0
"""Of a zoom that nobody sees, no more is believed."""
GNSS_WHITE_M = 0.3
DELAY_S = 0.1
"""A delay between the two shows where the velocity changes."""
ODOMETRY_S = 20.0
"""Errors of odometry last for so long; those of scale and heading for longer: they are learned."""
SCALE_SIGMA, SCALE_WALK_PER_SQRT_S = 0.02, 0.001
RATES_MPS = (0.3, 1.0, 3.0)
STEPS_M = (10.0, 100.0)
MIN_RATE_SIGMA_MPS = 0.05
RATE = ShiftModel(
    constant=0.05,
    constant_walk_per_sqrt_s=0.002,
    slow=0.05,
    slow_s=100.0,
    quick_s=ODOMETRY_S,
    steps=RATES_MPS,
    factor=SCALE_SIGMA,
    factor_walk_per_sqrt_s=SCALE_WALK_PER_SQRT_S,
)


@dataclass(frozen=True, slots=True)
class Lens:
    """By how much (1-sigma, a share) the focal length is doubted beyond what odometry claims, what a lens that is twice as
    long adds to a displacement beside its scale, north and east metres, and by how much more it may have zoomed unseen."""

    share: float = 0.0
    per_focal_ne_m: Vec2 = (0.0, 0.0)
    zoom_share: float = 0.0


RIGHT = Lens()


class OdometryTest:
    """Two sequential tests of GNSS against odometry; `log_r` is that of both together."""

    def __init__(self) -> None:
        self._rate = ShiftTest(RATE)
        self._to_ns: int | None = None
        self._restart()

    def _restart(self) -> None:
        self._apart = 0j
        self._v: complex | None = None
        self._place: ShiftTest | None = None
        self._weigh()
        self._clear_block()

    def _clear_block(self) -> None:
        self._gnss, self._odometry, self._var, self._span_s = 0j, 0j, 0.0, 0.0
        self._by_scale, self._by_swing, self._by_zoom = 0j, 0j, 0j

    @property
    def log_r(self) -> float:
        """The two tests' statistics, summed; minus infinity before the first block."""
        return self._log_r

    def _weigh(self) -> None:
        place = -math.inf if self._place is None else self._place.log_r
        self._log_r = float(np.logaddexp(self._rate.log_r, place))

    def forget(self) -> None:
        """Begin anew (trust was lost, or a probation starts)."""
        self._rate = self._rate.fork()
        self._restart()

    def add(self, t_from_ns: int, t_to_ns: int, gnss_ne_m: Vec2, odometry_ne_m: Vec2, var_m2: float, lens: Lens = RIGHT) -> None:
        """Take the displacements of both over an interval; `var_m2` is what odometry claims, per axis. What a lens does to
        neighbouring intervals adds up."""
        if self._to_ns is not None and not -0.5 * GAP_S <= (t_from_ns - self._to_ns) * 1e-9 <= GAP_S:
            self._restart()
        self._to_ns = t_to_ns
        self._gnss += complex(*gnss_ne_m)
        self._odometry += complex(*odometry_ne_m)
        self._var += var_m2
        share = lens.share + lens.zoom_share
        self._by_swing += share * complex(*lens.per_focal_ne_m)
        if lens.zoom_share > 0:
            self._by_zoom += share * complex(*odometry_ne_m)
        else:
            self._by_scale += share * complex(*odometry_ne_m)
        self._span_s += (t_to_ns - t_from_ns) * 1e-9
        if self._span_s >= BLOCK_S:
            self._finish(t_to_ns * 1e-9)
            self._clear_block()

    def _finish(self, t_s: float) -> None:
        """What lasts of the odometry's error is no smaller than a floor; its claimed variances add up as independent ones."""
        span_s, v = self._span_s, self._odometry / self._span_s
        turn_var = 0.0 if self._v is None else (DELAY_S * abs(v - self._v)) ** 2
        self._v = v
        by_lens_m2 = (abs(self._by_scale) ** 2 + abs(self._by_swing) ** 2) / 2
        rate_var = max((self._var + by_lens_m2) / span_s**2, MIN_RATE_SIGMA_MPS**2)
        apart = self._held_across(self._gnss - self._odometry, rate_var * span_s**2)
        self._rate.update(t_s, apart / span_s, (2 * GNSS_WHITE_M**2 + turn_var) / span_s**2, rate_var, v)
        self._apart += apart
        if self._place is None:
            self._place = ShiftTest(_place_model(rate_var))
        self._place.update(t_s, self._apart, GNSS_WHITE_M**2 + turn_var, 0.0, self._odometry)
        self._place.summed(self._odometry)
        self._weigh()

    def _held_across(self, apart: complex, var_m2: float) -> complex:
        """What lies between both, less what an unseen zoom accounts for: along the way, all up to so many of its sigmas but as
        much as there is beside it (`var_m2`)."""
        zoom_m = abs(self._by_zoom)
        if zoom_m == 0:
            return apart
        way = self._by_zoom / zoom_m
        along = (apart * way.conjugate()).real
        left = max(abs(along) * math.sqrt(var_m2 / (var_m2 + zoom_m**2)), abs(along) - ZOOM_SIGMAS * zoom_m)
        return apart - (along - math.copysign(left, along)) * way


def _place_model(rate_var: float) -> ShiftModel:
    """The summed difference: velocity errors of ODOMETRY_S walk, those of scale and heading add what each block's way makes of
    them then."""
    walk = math.sqrt(2 * ODOMETRY_S * rate_var)
    return ShiftModel(GNSS_WHITE_M, walk, GNSS_WHITE_M, 100.0, ODOMETRY_S, STEPS_M, (), SCALE_SIGMA, SCALE_WALK_PER_SQRT_S)
