"""Which parts of a surface model lie in cast shadow, of a sun anywhere in the sky."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

FURTHEST_SHADOW_M = 110.0
ROUNDING_M = 0.01
"""More than resampling a surface raises it by."""


def cast_shadow(surface_m: NDArray[np.float32], gsd_m: float, azimuth_deg: float, elevation_deg: float) -> NDArray[np.float32]:
    """(H, W) height above the surface up to which the air is in shadow, metres (0 in sunlight).

    `azimuth_deg` is clockwise from the grid's upward axis. The height of the shadow is the largest of the surface towards the
    sun less what the sun's ray climbs until there; it is found in doubling steps: each step looks twice as far as the one before,
    until the ray has climbed by more than all of the surface does.
    """
    azimuth = math.radians(azimuth_deg)
    towards = np.array([math.sin(azimuth), -math.cos(azimuth)])
    climb_m = math.tan(math.radians(elevation_deg)) * gsd_m
    shadow, step, relief_m = surface_m, 1.0, float(surface_m.max() - surface_m.min()) + ROUNDING_M
    size = (surface_m.shape[1], surface_m.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    while step * gsd_m <= FURTHEST_SHADOW_M:
        if climb_m * step > relief_m:  # never where heights are missing
            break
        shift = np.array([[1.0, 0.0, towards[0] * step], [0.0, 1.0, towards[1] * step]])
        moved = np.asarray(cv2.warpAffine(shadow, shift, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)
        moved -= np.float32(climb_m * step)
        shadow = np.maximum(shadow, moved, out=moved)
        step *= 2
    return np.asarray(shadow - surface_m, dtype=np.float32)
