"""Which parts of a surface model lie in cast shadow, of a sun anywhere in the sky."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

FURTHEST_SHADOW_M = 110.0


def cast_shadow(surface_m: NDArray[np.float32], gsd_m: float, azimuth_deg: float, elevation_deg: float) -> NDArray[np.float32]:
    """(H, W) height above the surface up to which the air is in shadow, metres (0 in sunlight).

    `azimuth_deg` is clockwise from the grid's upward axis. The height of the shadow is the largest of the surface towards the
    sun less what the sun's ray climbs until there; it is found in doubling steps: each step looks twice as far as the one before.
    """
    azimuth = math.radians(azimuth_deg)
    towards = np.array([math.sin(azimuth), -math.cos(azimuth)])
    climb_m = math.tan(math.radians(elevation_deg)) * gsd_m
    shadow, step = surface_m, 1.0
    size = (surface_m.shape[1], surface_m.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    while step * gsd_m <= FURTHEST_SHADOW_M:
        shift = np.array([[1.0, 0.0, towards[0] * step], [0.0, 1.0, towards[1] * step]])
        moved = cv2.warpAffine(shadow, shift, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        shadow = np.maximum(shadow, moved - np.float32(climb_m * step))
        step *= 2
    return np.asarray(shadow - surface_m, dtype=np.float32)
