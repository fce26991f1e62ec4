"""Where the rays of a frame first meet the surface model: coarse marching for bounds, fine marching between, then regula falsi.

All rays are followed by level: at height z a ray is above pix `base + slope (camera - z)` of the scene's raster, so one step of
all rays is one cv2.remap. First hits are found, so what stands in front hides what is behind.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]
Mask = NDArray[np.uint8]
COARSE = 4
FINE_STEPS = 10
MAX_COARSE_STEPS = 160


@dataclass(frozen=True)
class Rays:
    """Rays of an image by level. `slope_u`, `slope_v` (H, W): scene pixels gained for each metre of descent.

    `base_u`, `base_v` (H, 1) are the camera's own scene pix while each row is exposed, `camera_h_m` its height in the middle of
    the exposure. `px_per_m` is the scene's resolution on the ground.
    """

    base_u: Plane
    base_v: Plane
    slope_u: Plane
    slope_v: Plane
    camera_h_m: float
    px_per_m: float

    def every(self, stride: int) -> Rays:
        """The rays of every so many rows and columns."""
        return Rays(
            np.ascontiguousarray(self.base_u[::stride]),
            np.ascontiguousarray(self.base_v[::stride]),
            np.ascontiguousarray(self.slope_u[::stride, ::stride]),
            np.ascontiguousarray(self.slope_v[::stride, ::stride]),
            self.camera_h_m,
            self.px_per_m,
        )

    def at(self, z: Plane | float) -> tuple[Plane, Plane]:
        """Scene pix (u, v) of every ray at its level."""
        drop = np.float32(self.camera_h_m) - np.asarray(z, dtype=np.float32)
        return self.slope_u * drop + self.base_u, self.slope_v * drop + self.base_v


def height_at(dsm_m: Plane, u: Plane, v: Plane) -> Plane:
    """Surface heights at pix coordinates; beyond the edge the edge goes on."""
    return np.asarray(cv2.remap(dsm_m, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def _where(values: Plane, comparison: int, limit: float) -> Mask:
    """255 where the comparison with a number holds (three times as fast as numpy; the stubs know no numbers)."""
    return np.asarray(cv2.compare(values, limit, comparison), dtype=np.uint8)  # type: ignore[call-overload]


def hit_levels(dsm_m: Plane, rays: Rays, highest_m: float, lowest_m: float) -> Plane:
    """(H, W) heights at which rays first meet the surface. Bounds must enclose the surface under the rays."""
    top = min(highest_m + 0.05, rays.camera_h_m - 0.01)
    bottom = min(lowest_m - 0.05, top - 0.1)
    coarse = rays.every(COARSE)
    upper, lower = _bounds(dsm_m, coarse, top, bottom)
    size = (rays.slope_u.shape[1], rays.slope_u.shape[0])
    return _march(dsm_m, rays, _grown(upper, size), _grown(lower, size))


def _grown(values: Plane, size: tuple[int, int]) -> Plane:
    """Coarse values at every pixel: the coarse sample (i, j) stands at pixel (COARSE i, COARSE j)."""
    to_coarse = np.array([[1 / COARSE, 0, 0], [0, 1 / COARSE, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(values, to_coarse, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def _bounds(dsm_m: Plane, rays: Rays, top: float, bottom: float) -> tuple[Plane, Plane]:
    """Levels just above and below the first hit of each coarse ray and of its neighbours."""
    steepest = float(np.percentile(np.maximum(np.abs(rays.slope_u), np.abs(rays.slope_v)), 99))
    steps = int(np.clip((top - bottom) * steepest / 1.2, 16, MAX_COARSE_STEPS))
    step = (top - bottom) / steps
    u, v = rays.at(top)
    du, dv = rays.slope_u * np.float32(step), rays.slope_v * np.float32(step)
    hit = np.full(u.shape, bottom, np.float32)
    open_rays = np.ones(u.shape, np.uint8)
    for k in range(1, steps + 1):
        u += du
        v += dv
        level = top - step * k
        met = _where(height_at(dsm_m, u, v), cv2.CMP_GE, level) & open_rays
        if met.any():
            hit[met > 0] = level
            open_rays &= ~met
            if not open_rays.any():
                break
    window = np.ones((3, 3), np.uint8)
    margin = np.float32(step)
    upper = cv2.dilate(hit, window) + 2 * margin
    lower = cv2.erode(hit, window) - margin
    return np.minimum(upper, np.float32(top)), np.maximum(lower, np.float32(bottom))


def _march(dsm_m: Plane, rays: Rays, upper: Plane, lower: Plane) -> Plane:
    """First crossings between per-ray bounds; a ray that meets nothing in between gets the lower one."""
    step = (upper - lower) * np.float32(1 / FINE_STEPS)
    u, v = rays.at(upper)
    du, dv = rays.slope_u * step, rays.slope_v * step
    z_above, z_below = upper.copy(), lower.copy()
    over_above, over_below = upper - height_at(dsm_m, u, v), np.full(upper.shape, -1e-3, np.float32)
    z = upper.copy()
    unmet = np.full(upper.shape, 255, np.uint8)
    for _ in range(FINE_STEPS):
        u += du
        v += dv
        z -= step
        over = z - height_at(dsm_m, u, v)
        under = _where(over, cv2.CMP_LE, 0.0)
        met = under & unmet
        unmet = unmet - met
        cv2.copyTo(z, met, z_below)
        cv2.copyTo(over, met, over_below)
        cv2.copyTo(z, unmet, z_above)
        cv2.copyTo(over, unmet, over_above)
    for _ in range(2):
        z = _crossing(z_above, over_above, z_below, over_below)
        over = z - height_at(dsm_m, *rays.at(z))
        under = _where(over, cv2.CMP_LE, 0.0)
        above = ~under
        cv2.copyTo(z, under, z_below)
        cv2.copyTo(over, under, over_below)
        cv2.copyTo(z, above, z_above)
        cv2.copyTo(over, above, over_above)
    return _crossing(z_above, over_above, z_below, over_below)


def _crossing(z_above: Plane, over_above: Plane, z_below: Plane, over_below: Plane) -> Plane:
    share = np.clip(over_above / np.maximum(over_above - over_below, np.float32(1e-6)), 0, 1)
    return np.asarray(z_above + (z_below - z_above) * share, dtype=np.float32)
