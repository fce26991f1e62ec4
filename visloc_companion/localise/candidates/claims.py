"""The covariance that a fix claims, from what the blocks of the frame show of themselves.

The pose's formal covariance takes the blocks' errors for independent. Neighbours share the surface model's and the map's
errors, and the more the wider the blocks scatter: the formal sigmas are widened by a power of the scatter. What all blocks
share shows in none of them: a floor. What the prior knew is widened by neither (pose.py): a fix of blocks that tell nothing
claims what its prior did, and no more.
"""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.pose import PoseEstimate
from visloc_companion.types import FloatArray

FACTOR = 1.05
"""On the formal sigmas of blocks that scatter by a pixel or less, ..."""
SHARED_POWER = 0.25
"""... times this power of a larger scatter, ..."""
FLOOR_PX = 0.15
"""... and the horizontal sigma (working pixels) that is added in any case. Fitted on NAIP rows < 400 and on leaning views of
procedural worlds 40 to 47."""


def widening(scatter: float) -> float:
    """Factor on the formal sigmas of blocks that scatter so much about their pose."""
    return float(FACTOR * max(1.0, scatter) ** SHARED_POWER)


def claimed_covariance(estimate: PoseEstimate, gsd_m: float) -> FloatArray:
    """(6, 6) of north, east, up (metres) and rotation about them (radians) from a pose of blocks, solved with that `widening`, at
    a working resolution."""
    covariance = estimate.covariance.copy()
    covariance[:2, :2] += np.eye(2) * (FLOOR_PX * gsd_m) ** 2
    return covariance


def with_prior_tilt(covariance: FloatArray, sigma_tilt_rad: float, agl_m: float) -> FloatArray:
    """The (6, 6) covariance of a method that takes the prior's tilt for exact, with what that tilt may be off by.

    A camera so far above the ground that leans by more than was thought is by that angle beside where it is put.
    """
    beside_m = agl_m * sigma_tilt_rad
    added = np.array([beside_m, beside_m, 0.0, sigma_tilt_rad, sigma_tilt_rad, 0.0])
    return np.asarray(covariance + np.diag(added**2), dtype=np.float64)


def horizontal_sigma(covariance: FloatArray) -> float:
    """1-sigma (metres) along the worst horizontal axis of a covariance of north, east, ..."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
