"""Tells the operator once that the lens is not as it was calibrated: the filter allows for it (propagation.FIX_LENS), but heights
and matches suffer, and a calibration mends it.

The filter learns it from what fixes claim to err by. What neighbouring ones get wrong in common beside that (the map's
registration, a tilt that errs for a while) looks like a lens where it changes as the camera leans another way; and a mounting
that is off looks like one for as long as the lean stays the same in the vehicle's own axes. So a swing of the lean tells as much
as it is large against the former, seen from the ground or from the vehicle, whichever is less: `LensSwings`.
"""

from __future__ import annotations

import cmath
import math

from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.propagation import FIX_LENS, SLOW
from visloc_companion.types import Command, Notice, Severity, Vec2

LEAST_SHARE, SURE_SIGMA = 0.015, 4.0
HELD_NS = 20_000_000_000
"""It has to stay so for so long: an attitude that errs for some seconds looks like another lens while the camera leans."""

COMMON_M, COMMON_TILT_RAD, APART_NS = 0.8, math.radians(0.3), 10_000_000_000
"""1-sigma, on each axis, of what fixes get wrong in common from one swing to the next: the map, and the tilt (times the height);
fixes so far apart are compared."""
LASTS_S = next(tau_s for state, _, tau_s in SLOW if state == FIX_LENS)


class LensSwings:
    """How surely fixes can tell the lens, by how far what it does to them has swung over. `sigma_share`: 1-sigma of a share."""

    def __init__(self) -> None:
        self._last: tuple[int, complex, complex] | None = None
        self._information = 0.0

    @property
    def sigma_share(self) -> float:
        """Infinite before it swung at all."""
        return 1 / math.sqrt(self._information) if self._information > 0 else math.inf

    def on_fix(self, t_ns: int, per_focal_ne_m: Vec2, heading_rad: float, height_m: float) -> None:
        """Take what a lens that is twice as long adds to a fix, with the vehicle's heading and from a height."""
        leans = complex(*per_focal_ne_m)
        seen = t_ns, leans, leans * cmath.rect(1.0, -heading_rad)
        self._last = seen if self._last is None else self._last
        before_ns, leant, leant_frd = self._last
        if t_ns - before_ns < APART_NS:
            return
        swung_m = min(abs(seen[1] - leant), abs(seen[2] - leant_frd))
        self._information *= math.exp(-(t_ns - before_ns) * 1e-9 / LASTS_S)
        self._information += swung_m**2 / (2 * math.hypot(COMMON_M, COMMON_TILT_RAD * height_m) ** 2)
        self._last = seen


class LensWatch:
    """Looks at each belief that a fix has led to."""

    def __init__(self) -> None:
        self._told = False
        self._since_ns: int | None = None

    def after(self, belief: Belief, common_share: float = 0.0) -> list[Command]:
        """What is to be said now; `common_share`: 1-sigma of a lens that fixes feign in common (LensSwings)."""
        longer, sigma = float(belief.x[FIX_LENS]), math.sqrt(float(belief.P[FIX_LENS, FIX_LENS]) + common_share**2)
        if abs(longer) < max(LEAST_SHARE, SURE_SIGMA * sigma):
            self._since_ns = None
            return []
        self._since_ns = belief.t_ns if self._since_ns is None else self._since_ns
        if self._told or belief.t_ns - self._since_ns < HELD_NS:
            return []
        self._told = True
        text = f"visloc: lens {100 * abs(longer):.1f} % {'longer' if longer > 0 else 'shorter'} than calibrated"
        data = (("longer_share", longer), ("sigma_share", sigma))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]
