"""Where a pinhole camera sees points, and how that changes when they move: for Gauss-Newton on poses and points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

LEAST_DEPTH_M = 1e-3


def projected(q_cam_m: FloatArray, focal_px: float) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Of points (N, 3) in `cam`: normalised coordinates (N, 2), derivative (N, 2, 3) of the pixels, and what lies ahead (N,).

    A point that does not lie ahead gets the numbers of one at a depth of 1 m, which mean nothing.
    """
    ahead = q_cam_m[:, 2] > LEAST_DEPTH_M
    z = np.where(ahead, q_cam_m[:, 2], 1.0)
    xy = q_cam_m[:, :2] / z[:, None]
    J = np.zeros((len(z), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = focal_px / z
    J[:, :, 2] = -focal_px * xy / z[:, None]
    return xy, J, np.asarray(ahead, dtype=np.bool_)
