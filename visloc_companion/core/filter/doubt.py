"""One interval of odometry that contradicts all that is known is no news yet.

Either the velocity that drives the filter errs anew, by metres a second within a moment, as the autopilot's may when it corrects
itself; or odometry was deceived for once. Until another interval agrees with the first, or with what was known before it, the
velocity's error is as uncertain as both together leave it, and the position with it.

An inertial velocity does not err anew within a moment, so one interval widens nothing. But wrong fixes may have taught the filter
a false error of it: where a second interval says what the first did, and the camera is seen to move (a frozen one agrees with
itself, too), odometry is right, and what the filter holds has been carried away for as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter.belief import Belief, Doubt, widened, widened_by
from visloc_companion.core.filter.propagation import (
    ACCELERATION,
    INERTIAL_WALK_MPS_PER_SQRT_S,
    N_STATES,
    POSITION,
    VELOCITY,
    Drive,
)
from visloc_companion.core.filter.relocalise import STANDING_MPS
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

MOST_CHANGE_MPS = 10.0
"""The autopilot's velocity errs by metres a second within a moment when it brakes or turns; by more than this, odometry errs."""
CARRIED_MPS2 = 0.5
"""What carried the filter away went into the autopilot's attitude, too: it tilts by 3 degrees, and accelerations with it."""
LEAST_SHARE = 0.1
"""An interval of which the present velocity drove less tells too little of it for a doubt."""


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """An interval against the belief at its end: by how much the mean error that it measures is another than believed, `off`
    (2,) with covariance `R` (2, 2), m/s, and the share of the interval that the present velocity drove; when it began, and how
    fast it has the camera move, m/s."""

    off: FloatArray
    R: FloatArray
    share: float
    since_ns: int
    moves_mps: float


def says_the_same(belief: Belief, doubt: Doubt, claim: Claim, settings: NavigatorSettings) -> bool:
    """Whether an interval says what the one in doubt said. Against an inertial velocity, standing pictures confirm nothing."""
    if belief.drive is Drive.INERTIAL and claim.moves_mps < STANDING_MPS:
        return False
    off = claim.off - claim.share * (doubt.error_ne_mps - belief.x[VELOCITY])
    return _within(off, doubt.cov_m2ps2 + _changed(belief, doubt, CARRIED_MPS2, settings), claim, settings)


def says_what_was_believed(belief: Belief, doubt: Doubt, claim: Claim, settings: NavigatorSettings) -> bool:
    """Whether an interval says what was believed before the one in doubt."""
    return _within(claim.off, doubt.believed_m2ps2 + _changed(belief, doubt, 0.0, settings), claim, settings)


def _within(off: FloatArray, cov: FloatArray, claim: Claim, settings: NavigatorSettings) -> bool:
    return float(off @ np.linalg.solve(claim.share**2 * cov + claim.R, off)) <= settings.gate_sigma**2


def _changed(belief: Belief, doubt: Doubt, carried_mps2: float, settings: NavigatorSettings) -> FloatArray:
    """(2, 2) by how much the velocity's error may be another than at the time of the doubt; accelerations that drive it err by
    `carried_mps2` or more."""
    since_s = (belief.t_ns - doubt.t_ns) * 1e-9
    if belief.drive is Drive.INERTIAL:
        sigma_a_mps2 = max(belief.sigma_a_mps2, carried_mps2)
        return ((sigma_a_mps2 * since_s) ** 2 + INERTIAL_WALK_MPS_PER_SQRT_S**2 * since_s) * np.eye(2)
    kept = math.exp(-since_s / settings.velocity_correlation_s)
    return np.asarray(2 * (1 - kept) * belief.sigma_v_mps**2 * np.eye(2))


def doubting(belief: Belief, claim: Claim) -> Belief:
    """The belief after an interval that nothing agrees with: wide enough for it to be right, as far as that is possible."""
    before = belief.doubt
    if claim.share < LEAST_SHARE:
        return belief
    off = claim.off / claim.share
    inertial = belief.drive is Drive.INERTIAL
    if float(np.abs(off).max()) > MOST_CHANGE_MPS or (inertial and claim.moves_mps < STANDING_MPS):
        return belief
    P = belief.P[VELOCITY, VELOCITY]
    believed = P if before is None else before.believed_m2ps2
    doubt = Doubt(claim.since_ns, belief.t_ns, belief.x[VELOCITY] + off, claim.R / claim.share**2, believed)
    if inertial:
        return belief._replace(doubt=doubt)
    more = float(np.max(off**2)) - (0.0 if before is None else float(np.min(np.diag(P))))
    return widened(belief, 0.0, max(0.0, more))._replace(doubt=doubt)


def carried_away(belief: Belief, doubt: Doubt, claim: Claim) -> Belief:
    """The belief, driven by an inertial velocity, once a second interval says what the one in doubt said: its error has been held
    for another since that one began, so position and velocity are off together, and the accelerations were learned wrong."""
    for_s = (belief.t_ns - doubt.since_ns) * 1e-9
    m2ps2 = float(np.max((claim.off / claim.share) ** 2)) * np.eye(2)
    more = np.zeros((N_STATES, N_STATES))
    more[VELOCITY, VELOCITY], more[POSITION, POSITION] = m2ps2, for_s**2 * m2ps2
    more[POSITION, VELOCITY] = more[VELOCITY, POSITION] = -for_s * m2ps2
    more[ACCELERATION, ACCELERATION] = belief.sigma_a_mps2**2 * np.eye(2)
    return widened_by(belief, more)
