"""What the velocity that drives the filter came to, and what was known of its error: dead reckoning from a moment on, which no
later fix changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter.belief import Belief
from visloc_companion.core.filter.propagation import ACCELERATION, INERTIAL_WALK_MPS_PER_SQRT_S, VELOCITY, Drive
from visloc_companion.types import FloatArray, Vec2


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """At a time: the way of the driving velocity since the filter began at `started_ns`, what is known of the errors of that
    velocity (m/s) and of its acceleration (m/s²), north and east, their covariance (2, 2) on each axis, and what drives."""

    travel_ne_m: Vec2
    error_ne_mps: Vec2
    error_ne_mps2: Vec2
    cov: FloatArray
    drive: Drive
    started_ns: int

    def carried_ne_m(self, dt_s: float) -> FloatArray:
        """What these errors come to so much later (of an inertial velocity), metres north and east."""
        return dt_s * np.array(self.error_ne_mps) + dt_s**2 / 2 * np.array(self.error_ne_mps2)

    def carried_m2(self, dt_s: float) -> float:
        """Variance of what they come to, on each axis."""
        by = np.array((dt_s, dt_s**2 / 2))
        return float(by @ self.cov @ by) + INERTIAL_WALK_MPS_PER_SQRT_S**2 * dt_s**3 / 3


def reckoned(belief: Belief) -> Reckoned:
    """What a belief knows of it."""
    (v_n, v_e), (a_n, a_e) = belief.x[VELOCITY].tolist(), belief.x[ACCELERATION].tolist()
    north, east = np.array((VELOCITY.start, ACCELERATION.start)), np.array((VELOCITY.start, ACCELERATION.start)) + 1
    cov = (belief.P[np.ix_(north, north)] + belief.P[np.ix_(east, east)]) / 2
    return Reckoned(belief.travel_ne_m, (v_n, v_e), (a_n, a_e), cov, belief.drive, belief.started_ns)


def way_ne_m(then: Reckoned | None, now: Reckoned | None, v_ne_mps: Vec2, since_s: float) -> Vec2:
    """How far the vehicle came from one time to another `since_s` later, metres north and east: by the driving velocity less what
    is known of its error, or where a filter does not go back so far by a velocity that is held."""
    if then is None or now is None or then.started_ns != now.started_ns:
        return v_ne_mps[0] * since_s, v_ne_mps[1] * since_s
    north, east = (now.travel_ne_m[k] - then.travel_ne_m[k] - now.error_ne_mps[k] * since_s for k in range(2))
    return north, east
