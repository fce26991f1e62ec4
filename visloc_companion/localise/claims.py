"""The covariance that a fix claims, from what the blocks of the frame show of themselves.

The pose's formal covariance takes the blocks' errors for independent. Neighbours share the surface model's and the map's
errors, and the more the wider the blocks scatter: the formal sigmas are widened by a power of the scatter. Where frame and map
are bent against each other smoothly, the blocks show the bend (warp.py). What all blocks share shows in none of them: the map's
own error, which is not part of this (`LocaliserSettings.map_sigma_m`, `navigator.map_sigma_m`), and a floor.
"""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.pose import PoseEstimate
from visloc_companion.localise.warp import warp_covariance
from visloc_companion.types import FloatArray

FACTOR = 1.05
"""On the formal sigmas of blocks that scatter by a pixel or less, ..."""
SHARED_POWER = 0.25
"""... times this power of a larger scatter, ..."""
FLOOR_PX = 0.05
"""... and the horizontal sigma (working pixels) in any case. Fitted beside a map's error of 0.7 m on NAIP rows < 400
(nadir, oblique and low), training pairs of the bi-temporal data and landscape seeds < 100."""


def claimed_covariance(estimate: PoseEstimate, gsd_m: float) -> FloatArray:
    """(6, 6) of north, east, up (metres) and rotation about them (radians) from a pose of blocks at a working resolution."""
    covariance = of_scatter(estimate, gsd_m)
    if estimate.errors is not None:
        covariance += warp_covariance(estimate.errors, estimate.weights, gsd_m)
    return covariance


def of_scatter(estimate: PoseEstimate, gsd_m: float) -> FloatArray:
    """The same without what a bend adds: cheap, for what a match is judged by."""
    factor = FACTOR * max(1.0, estimate.scatter) ** SHARED_POWER
    of_blocks = estimate.covariance - estimate.of_slope
    covariance = np.asarray(of_blocks * factor**2 + estimate.of_slope, dtype=np.float64)
    covariance[:2, :2] += np.eye(2) * (FLOOR_PX * gsd_m) ** 2
    return covariance


def horizontal_sigma(covariance: FloatArray) -> float:
    """1-sigma (metres) along the worst horizontal axis of a covariance of north, east, ..."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
