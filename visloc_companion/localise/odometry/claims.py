"""The answer: a displacement with the covariance that it is worth."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.localise.odometry.base import Sight, Step
from visloc_companion.localise.odometry.keyframe import Keyframe
from visloc_companion.localise.odometry.solve import Motion
from visloc_companion.types import FloatArray, Odometry

METHOD = "flow"
COMMON_PX = 0.2
"""1-sigma of what all tracks of a frame are off by together (interpolation, light), which no number of tracks averages away."""
LEAST_SHARE = 0.02
"""Displacements shorter than this share of the height tell nothing of their scale."""


def odometry_of(key: Keyframe, sight: Sight, motion: Motion, closes: bool) -> Step:
    """The step from a keyframe to a frame."""
    d = motion.d_ned_m
    scale = _scale(motion, key)
    common_m = COMMON_PX * key.height_m / float(key.picture.K[0, 0])
    swung = motion.by_lens_m[:2] - d[:2]
    own = motion.covariance - motion.shared + common_m**2 * np.eye(3)
    across = key.sight.sigma_yaw_rad * np.array([-d[1], d[0]])
    along, by_lens = scale * d[:2], FOCAL_SHARE * swung
    cov = own[:2, :2] + np.outer(across, across) + np.outer(along, along) + np.outer(by_lens, by_lens)
    cov = (cov + cov.T) / 2
    odometry = Odometry(
        sight.t_ns,
        key.sight.t_ns,
        sight.t_ns,
        (float(d[0]), float(d[1]), float(d[2])),
        ((float(cov[0, 0]), float(cov[0, 1])), (float(cov[1, 0]), float(cov[1, 1]))),
        scale,
        key.sight.sigma_yaw_rad,
        float(motion.fits.mean()),
        METHOD,
        FOCAL_SHARE,
        (float(swung[0]), float(swung[1])),
    )
    evidence = (
        ("tracks", float(len(motion.fits))),
        ("scatter_px", motion.scatter_px),
        ("roughness", motion.roughness),
        ("turn_rad", float(np.linalg.norm(motion.turn_rad))),
        ("height_m", key.height_m),
    )
    down_m2 = max(float(motion.covariance[2, 2]), 0.0) + (FOCAL_SHARE * float(motion.by_lens_m[2])) ** 2
    return Step(odometry, math.sqrt(down_m2), closes, evidence)


def _scale(motion: Motion, key: Keyframe) -> float:
    """1-sigma of the share by which this displacement and its neighbours are all too long or too short."""
    d: FloatArray = motion.d_ned_m[:2]
    length2 = float(d @ d)
    if length2 < (LEAST_SHARE * key.height_m) ** 2:
        heights = key.sight.sigma_up_m if key.mapped else key.sight.sigma_height_m
        return math.hypot(heights / key.height_m, FOCAL_SHARE)
    return math.hypot(math.sqrt(max(float(d @ motion.shared[:2, :2] @ d), 0.0)) / length2, FOCAL_SHARE)
