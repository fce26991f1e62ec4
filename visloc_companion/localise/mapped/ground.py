"""What is not known of the ground: gaps of a surface model, and without one its slope as the camera sees it.

A plane that leans looks like a camera that tilts: both bend the picture by the same quadratic terms, so without a surface model
a tilt is seen no better than the slope of what stands there is known, however sharp the picture. That slope has two parts:
roofs and trees, whose share falls with the side of the footprint, and the land itself. Fitted planes of upper surfaces from
airborne lidar lean by 4.2 degrees on each axis (root mean square, eight places) over 60 m and by 2.2 over 120 m; those of the
procedural landscape by 4.2 over 80 m and 3.6 over 160 m. The constants lie between the two.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo.tilt import LAND_RAD
from visloc_companion.localise.features.base import Float32Array, Mask

TREND_M = 1.2
"""What roofs and trees add to one axis' linear trend of the surface, standard deviation over the footprint (metres), beside the
slope of the land."""
LEVEL_M = 1e-3
"""A surface that varies by less is a plane that stands for an unknown one."""


def sigma_slope_rad(surface_up_m: Float32Array, side_m: float) -> float:
    """1-sigma of the slope on each axis that a window's surface (H, W) leaves open over a footprint of a side; 0 with a model."""
    if float(np.ptp(surface_up_m)) > LEVEL_M:
        return 0.0
    return math.hypot(TREND_M * math.sqrt(12.0) / side_m, LAND_RAD)


def filled(heights: Float32Array, valid: Mask) -> Float32Array:
    """(H, W) heights with the median of those known and valid where there are none."""
    known = np.isfinite(heights) & valid
    if known.all():
        return np.asarray(heights, dtype=np.float32)
    fill = float(np.median(heights[known])) if known.any() else 0.0
    return np.where(np.isfinite(heights), heights, np.float32(fill)).astype(np.float32)
