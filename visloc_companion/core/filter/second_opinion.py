"""A fix that may well be wrong, and would carry the filter far, waits for a second one that agrees with it.

Where the prior is as narrow as the fix, one that is wrong with 5 % costs little: other places were not even searched. After a
time without fixes it is all that is known. Once taken, the next frames are looked for about it, and a wrong one hides the right
place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NavState, Vec2

DOUBTFUL = 0.03
"""Probability of being wrong from which on a fix waits ..."""
FAR = 3.0
"""... where the filter's 1-sigma is more than so many times its own."""
AGREES_SIGMA = 3.0
FORGET_NS = 10_000_000_000
"""A fix is forgotten after that time, unless agreement is hardly chance ..."""
HARDLY_CHANCE = 0.05
"""... with a probability up to this: fixes that are rare would never find a second one."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    """By how much a fix would have moved the filter, metres north and east, and the 1-sigmas of both then."""

    t_ns: int
    off_ne_m: Vec2
    sigma_m: float
    filter_sigma_m: float


def doubtful(fix: Fix) -> bool:
    """Whether a fix waits where it would carry the filter far."""
    return fix.probability_wrong > DOUBTFUL


class SecondOpinion:
    """Remembers the last fix that waits."""

    def __init__(self) -> None:
        self._waiting: _Waiting | None = None

    def clear(self) -> None:
        """A fix was taken, or the filter is somewhere else: nothing waits any more."""
        self._waiting = None

    def waits(self, fix: Fix, state: NavState | None, origin: GeoPoint | None) -> bool:
        """Whether a fix waits, given the filter's state at its time; it is remembered then. Never before there is a state."""
        if state is None or origin is None or not doubtful(fix):
            return False
        sigma_m, known_m = largest_sigma_m(fix.cov_ne_m2), largest_sigma_m(state.cov_ne_m2)
        if known_m <= FAR * sigma_m:
            return False
        north, east, _ = wgs84.ned_from_geo(fix.place, origin)
        off_ne_m = (north - state.p_ned_m[0], east - state.p_ned_m[1])
        area_m2 = math.sqrt(max(0.0, float(np.linalg.det(state.cov_ne_m2))))
        now, before = _Waiting(fix.t_ns, off_ne_m, sigma_m, known_m), self._waiting
        self._waiting = now
        return before is None or not _agree(before, now, area_m2)


def _agree(before: _Waiting, now: _Waiting, area_m2: float) -> bool:
    """Whether two fixes say the same of the filter, up to their errors and to what it has moved wrongly in between; `area_m2`:
    square root of the determinant of its covariance now."""
    age_ns = now.t_ns - before.t_ns
    moved_m2 = max(0.0, now.filter_sigma_m**2 - before.filter_sigma_m**2)
    near_m2 = AGREES_SIGMA**2 * (before.sigma_m**2 + now.sigma_m**2 + moved_m2)
    # two places drawn from the filter's own distribution are so near with about near_m2 / (4 area): Rayleigh, twice the variance
    if age_ns <= 0 or (age_ns > FORGET_NS and near_m2 > 4 * HARDLY_CHANCE * area_m2):
        return False
    return math.dist(before.off_ne_m, now.off_ne_m) ** 2 <= near_m2
