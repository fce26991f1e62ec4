"""What earlier fixes tell of the tilt, taken into a prior, and what a frame itself tells of it.

A frame shows tilt and place together: over level ground a tilt moves the picture by nearly as much as a step to the side does.
Blocks and prior share the answer; what the blocks alone say of the tilt is the answer less the prior, in information form.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.geo import se3
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.localise.pose import LEAST_SIGMA, PoseEstimate, heading_and_tilt
from visloc_companion.types import PosePrior, TiltPrior, TiltSeen

WIDEST_RAD = math.radians(5.0)
"""Blocks that know the tilt about some axis no better than this (1-sigma) say nothing of it."""
LEAST_RAD = 1e-4
"""No attitude is known better, whatever a prior claims."""


def set_right(prior: PosePrior) -> PosePrior:
    """The prior with what earlier fixes tell of its tilt in its attitude and in its 1-sigma, which is no less than LEAST_RAD."""
    if prior.tilt is None:
        return prior if prior.sigma_tilt_rad >= LEAST_RAD else replace(prior, sigma_tilt_rad=LEAST_RAD)
    turned = se3.quat_multiply(se3.quat_from_vector((*prior.tilt.turn_ne_rad, 0.0)), prior.q_ned_frd)
    return replace(prior, q_ned_frd=turned, sigma_tilt_rad=max(prior.tilt.sigma_rad, LEAST_RAD), tilt=None)


def seen_tilt(estimate: PoseEstimate, prior: PosePrior) -> TiltSeen | None:
    """How the prior's attitude is tilted as the blocks alone have it, from the pose that blocks and prior gave; None where they
    know too little of it."""
    of_prior = np.eye(2) / max(estimate.sigma_tilt_rad, LEAST_SIGMA) ** 2
    of_both = np.linalg.inv(estimate.covariance[3:5, 3:5])
    of_blocks = of_both - of_prior
    if float(np.linalg.eigvalsh(of_blocks)[0]) < 1 / WIDEST_RAD**2:
        return None
    _, tilt = heading_and_tilt(estimate.pose.R_ned_cam, se3.R_from_quat(prior.q_ned_frd) @ R_FRD_CAM)
    north, east = np.linalg.solve(of_blocks, of_both @ tilt).tolist()
    (nn, ne), (_, ee) = np.linalg.inv(of_blocks).tolist()
    return TiltSeen((north, east), ((nn, ne), (ne, ee)))


def beyond(seen: TiltSeen | None, known: TiltPrior | None) -> TiltSeen | None:
    """What is seen against a prior that was set right, as against the one before that."""
    if seen is None or known is None:
        return seen
    (north, east), (known_north, known_east) = seen.turn_ne_rad, known.turn_ne_rad
    return replace(seen, turn_ne_rad=(north + known_north, east + known_east))
