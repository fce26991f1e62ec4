"""Rays from the camera to the ground."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from visloc_companion.types import FloatArray

SurfaceHeight = Callable[[FloatArray], FloatArray]
"""(N, 2) north, east metres -> (N,) surface height above the same zero as the camera's height; NaN outside."""


def intersect_surface(
    p_cam_ned_m: FloatArray,
    ray_ned: FloatArray,
    surface_up_m: SurfaceHeight,
    highest_up_m: float,
    lowest_up_m: float,
    steps: int = 48,
) -> FloatArray:
    """(N, 3) NED points where rays first meet a surface: marching from the highest to the lowest level, then bisection.

    Heights are up-positive about the NED origin. Rays that do not descend or miss the surface give NaN, and so do those that are
    below it where it begins: they met the ground in a gap before. Parts of the surface thinner than (highest - lowest) / steps in
    height may be stepped over.
    """
    down = np.where(ray_ned[:, 2] > 1e-6, ray_ned[:, 2], np.nan)
    top = np.maximum(p_cam_ned_m[2], -highest_up_m)
    t_low = (top - p_cam_ned_m[2]) / down
    t_high = np.full_like(t_low, np.nan)
    previous = t_low
    for k in range(1, steps + 1):
        level_down = top + (-lowest_up_m - top) * k / steps
        t = (level_down - p_cam_ned_m[2]) / down
        under = surface_up_m(p_cam_ned_m[:2] + ray_ned[:, :2] * t[:, None]) >= -level_down
        first = under & np.isnan(t_high)
        t_high = np.where(first, t, t_high)
        t_low = np.where(first, previous, t_low)
        previous = t
        if not np.isnan(t_high).any():
            break
    for _ in range(12):
        t = (t_low + t_high) / 2
        p = p_cam_ned_m + ray_ned * t[:, None]
        under = surface_up_m(p[:, :2]) >= -p[:, 2]
        t_high, t_low = np.where(under, t, t_high), np.where(under, t_low, t)
    above = p_cam_ned_m[:2] + ray_ned[:, :2] * t_low[:, None]
    met = np.where(np.isfinite(surface_up_m(above)), (t_low + t_high) / 2, np.nan)
    return np.asarray(p_cam_ned_m + ray_ned * met[:, None], dtype=np.float64)
