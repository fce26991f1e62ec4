"""The camera's own motion tells the error of the autopilot's velocity, whatever that velocity rests on.

Between two times the filter's velocity input travels one way and odometry another: their difference over the time is the mean
error b of the input, whose present value differs from it by little (propagation.py). Odometry does not come from our own fixes,
so b may be learned from it even while the autopilot flies on them (fusion.py).

An interval in which one driving velocity followed another tells of the present one what is left when the error of the former is
taken off, which is as well known as it was when that one ended.

One interval that contradicts all that is known is not believed alone (doubt.py), but where the filter would agree with it without
some of its last fixes, these are left out (exclusion.py).

Errors of scale, heading and focal length stay for minutes: no number of intervals averages them away. They are states, which
fixes tell from the velocity's own error; what an interval claims beyond what those states allow for leaves b no better known
than it says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter.belief import Belief, Doubt
from visloc_companion.core.filter.doubt import Claim, carried_away, doubting, says_the_same, says_what_was_believed
from visloc_companion.core.filter.exclusion import excluding
from visloc_companion.core.filter.fusion import UNIT, taken
from visloc_companion.core.filter.propagation import (
    ACCELERATION,
    INERTIAL_WALK_MPS_PER_SQRT_S,
    N_STATES,
    ODOMETRY_HEADING,
    ODOMETRY_HEADING_SIGMA_RAD,
    ODOMETRY_LENS,
    ODOMETRY_LENS_SIGMA,
    ODOMETRY_SCALE,
    ODOMETRY_SCALE_SIGMA,
    VELOCITY,
    Drive,
)
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.types import Accepted, Cov2, FloatArray, Rejected, Vec2

MEAN_VELOCITY: FloatArray = np.eye(N_STATES)[VELOCITY]
MEAN_ACCELERATION: FloatArray = np.eye(N_STATES)[ACCELERATION]
NO_NEWS = 1e-6
UNHEARD_M2PS2 = 1e6
"""Variance of a measurement that is to say nothing on an axis."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Odometry over an interval that ends at `t_ns`: horizontal displacement north, east (metres).

    `cov_ne_m2` is the error of this interval alone; `sigma_scale` (a share), `sigma_heading_rad` and `sigma_focal` (a share,
    times `per_focal_ne_m`) are 1-sigmas of what it has in common with other intervals.
    """

    t_ns: int
    t_from_ns: int
    d_ne_m: Vec2
    cov_ne_m2: Cov2
    sigma_scale: float = 0.0
    sigma_heading_rad: float = 0.0
    sigma_focal: float = 0.0
    per_focal_ne_m: Vec2 = (0.0, 0.0)

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return (self.t_ns - self.t_from_ns) * 1e-9


def learned(belief: Belief, motion: Motion, travel_ne_m: Vec2, settings: NavigatorSettings) -> tuple[Belief, Accepted | Rejected]:
    """The belief at `motion.t_ns` after the motion; `travel_ne_m` is what the driving velocity travelled in that time.

    Rejected(TOO_OLD) for one that began two driving velocities ago.
    """
    dt, former, share = motion.duration_s, belief.former, 1.0
    z = (np.array(travel_ne_m) - np.array(motion.d_ne_m)) / dt
    alone = np.array(motion.cov_ne_m2) / dt**2
    if former is not None and motion.t_from_ns < former.until_ns:
        if motion.t_from_ns < former.since_ns:
            return belief, Rejected(Reason.TOO_OLD, 0.0)
        share = (motion.t_ns - former.until_ns) * 1e-9 / dt
        z -= (1 - share) * former.error_ne_mps
        alone += (1 - share) ** 2 * former.cov_m2ps2
    H, lag_m2ps2 = _seen(belief, motion, share, settings)
    alone += lag_m2ps2 * UNIT
    R = weighed(alone, H @ belief.P @ H.T, _beyond(motion))
    claim = Claim(z - H @ belief.x, R, share, motion.t_from_ns, math.hypot(*motion.d_ne_m) / dt)
    believed = None if belief.doubt is None else _confirmed(belief, belief.doubt, claim, settings)
    if believed is None and belief.drive is Drive.INERTIAL:
        believed = excluding(belief, z, R, H)
    if believed is not None:
        return taken(believed._replace(doubt=None), z, R, H)
    if belief.doubt is not None:
        return doubting(belief, claim), Rejected(Reason.GATED, math.inf)
    after, outcome = taken(belief, z, R, H, settings.gate_sigma)
    gated = isinstance(outcome, Rejected) and outcome.reason is Reason.GATED
    return doubting(belief, claim) if gated else after, outcome


def _confirmed(belief: Belief, doubt: Doubt, claim: Claim, settings: NavigatorSettings) -> Belief | None:
    """The belief that takes an interval as it is, because that says what the one in doubt said or what was believed before; None
    where it says neither."""
    if says_the_same(belief, doubt, claim, settings):
        return carried_away(belief, doubt, claim) if belief.drive is Drive.INERTIAL else belief
    return belief if says_what_was_believed(belief, doubt, claim, settings) else None


def _seen(belief: Belief, motion: Motion, share: float, settings: NavigatorSettings) -> tuple[FloatArray, float]:
    """H (2, 17) of the velocity's mean error over the interval less odometry's own, and the variance of what it leaves out.

    `share`: the last part of the interval, in which the present velocity drove.
    """
    dt = motion.duration_s
    north, east = motion.d_ne_m[0] / dt, motion.d_ne_m[1] / dt
    H = share * MEAN_VELOCITY
    H[:, ODOMETRY_SCALE] = -north, -east
    H[:, ODOMETRY_HEADING] = east, -north
    H[:, ODOMETRY_LENS] = -motion.per_focal_ne_m[0] / dt, -motion.per_focal_ne_m[1] / dt
    if belief.drive is Drive.INERTIAL:
        return H - share**2 * dt / 2 * MEAN_ACCELERATION, INERTIAL_WALK_MPS_PER_SQRT_S**2 * dt / 3
    return H, belief.sigma_v_mps**2 * 2 * dt / (3 * settings.velocity_correlation_s)


def _beyond(motion: Motion) -> FloatArray:
    """Variances (2,) of the mean velocity, of errors of scale, heading and lens beyond what the states for them allow."""
    scale = max(0.0, motion.sigma_scale**2 - ODOMETRY_SCALE_SIGMA**2)
    heading = max(0.0, motion.sigma_heading_rad**2 - ODOMETRY_HEADING_SIGMA_RAD**2)
    lens = max(0.0, motion.sigma_focal**2 - ODOMETRY_LENS_SIGMA**2)
    moved2, focal2 = np.square(motion.d_ne_m), np.square(motion.per_focal_ne_m)
    return np.asarray((scale * moved2 + heading * moved2[::-1] + lens * focal2) / motion.duration_s**2)


def weighed(R: FloatArray, P: FloatArray, least: FloatArray) -> FloatArray:
    """R (2, 2) raised so that a measurement of a state with covariance P (2, 2) leaves no axis a variance below `least` (2,)."""
    raised = [
        _raised(float(R[axis, axis]), float(P[axis, axis]), least_of_axis) for axis, least_of_axis in enumerate(least.tolist())
    ]
    return np.array([[raised[0], R[0, 1]], [R[0, 1], raised[1]]])


def _raised(alone: float, before: float, least: float) -> float:
    """The variance of a measurement so that one of `before` is left no smaller than `least` by it; at least its own."""
    news = 1 / max(1 / (1 / before + 1 / alone), least) - 1 / before
    return max(1 / max(news, 1e-12) if news > NO_NEWS / before else UNHEARD_M2PS2, alone)
