"""One interval of odometry that contradicts all that is known is no news yet.

Either the velocity that drives the filter errs anew, by metres a second within a moment, as the autopilot's may when it corrects
itself; or odometry was deceived for once. Until another interval agrees with the first, or with what was known before it, the
velocity's error is as uncertain as both together leave it, and the position with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core.belief import Belief, Doubt, widened
from visloc_companion.core.propagation import VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

MOST_CHANGE_MPS = 10.0
"""The autopilot's velocity errs by metres a second within a moment when it brakes or turns; by more than this, odometry errs. An
inertial velocity cannot: there the gate holds."""
LEAST_SHARE = 0.1
"""An interval of which the present velocity drove less tells too little of it for a doubt."""


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """An interval against the belief at its end: by how much the mean error that it measures is another than believed, `off`
    (2,) with covariance `R` (2, 2), m/s, and the share of the interval that the present velocity drove."""

    off: FloatArray
    R: FloatArray
    share: float


def agrees(belief: Belief, doubt: Doubt, claim: Claim, settings: NavigatorSettings) -> bool:
    """Whether an interval says what the one in doubt said, or what was believed before that one."""
    kept = math.exp(-(belief.t_ns - doubt.t_ns) * 1e-9 / settings.velocity_correlation_s)
    changed = 2 * (1 - kept) * belief.sigma_v_mps**2 * np.eye(2)
    said = claim.off - claim.share * (doubt.error_ne_mps - belief.x[VELOCITY])
    each = ((said, doubt.cov_m2ps2), (claim.off, doubt.believed_m2ps2))
    return any(
        float(off @ np.linalg.solve(claim.share**2 * (cov + changed) + claim.R, off)) <= settings.gate_sigma**2
        for off, cov in each
    )


def doubting(belief: Belief, claim: Claim) -> Belief:
    """The belief after an interval that nothing agrees with: wide enough for it to be right, as far as that is possible."""
    before = belief.doubt
    if claim.share < LEAST_SHARE:
        return belief
    off = claim.off / claim.share
    if float(np.abs(off).max()) > MOST_CHANGE_MPS or (belief.drive is Drive.INERTIAL and before is None):
        return belief
    P = belief.P[VELOCITY, VELOCITY]
    believed = P if before is None else before.believed_m2ps2
    more = float(np.max(off**2)) - (0.0 if before is None else float(np.min(np.diag(P))))
    doubt = Doubt(belief.t_ns, belief.x[VELOCITY] + off, claim.R / claim.share**2, believed)
    return replace(widened(belief, 0.0, max(0.0, more)), doubt=doubt)
