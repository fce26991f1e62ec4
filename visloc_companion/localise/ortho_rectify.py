"""Ortho-rectification: the frame as it would look on the map's grid, from a pose, a height and the surface.

A pixel x of the map grid at ground point P (metres north, east; down) is filled with the frame at K R_cam_ned (P - p_cam).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.frame import FrameLevel
from visloc_companion.types import FloatArray

MAX_TAN_INCIDENCE = 3.0
"""Ground seen flatter than atan(1/3) is left out: a map pixel there covers many heights and few frame pixels."""

STEEP_COS = math.cos(math.radians(12.0))
"""A camera that leans less than that sees no ground as flat, and samples all of it alike."""
FULL_SAMPLING = 1.5
"""Grid pixels that hold 1 / FULL_SAMPLING pixels of the frame or more count fully."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Position (3,) north, east, down (metres, down counted from sea level) about a local origin, and `R_ned_cam` (3, 3)."""

    p_ned_m: FloatArray
    R_ned_cam: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MapGrid:
    """A window of the map as the localiser uses it, at one level.

    `features` (H, W, C) and `weight` (H, W) float32 in 0..1; `surface_up_m` (H, W) float32, height above sea level;
    `A_ne_pix` (2, 3) maps `pix` to metres north and east of the local origin; `dsm_gsd_m` as types.ReferencePatch.
    """

    features: Float32Array
    weight: Float32Array
    surface_up_m: Float32Array
    A_ne_pix: FloatArray
    gsd_m: float
    dsm_gsd_m: float = 0.0


def ground_homography(K: FloatArray, pose: CameraPose, A_ne_pix: FloatArray, ground_up_m: float) -> FloatArray:
    """(3, 3) frame-from-grid homography of the plane at `ground_up_m`."""
    columns = np.zeros((3, 3))
    columns[:2] = A_ne_pix
    columns[:2, 2] -= pose.p_ned_m[:2]
    columns[2, 2] = -ground_up_m - pose.p_ned_m[2]
    return np.asarray(K @ pose.R_ned_cam.T @ columns, dtype=np.float64)


def rectify_plane(
    level: FrameLevel, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float
) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Frame on a grid of (width, height) pixels over a horizontal plane: (H, W) grey and the mask of what the frame shows.

    (H, W, C) where the level holds features.
    """
    H = ground_homography(level.K, pose, A_ne_pix, ground_up_m)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = np.asarray(cv2.warpPerspective(level.grey, H, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)
    seen = cv2.warpPerspective(level.valid, H, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, borderValue=0) > 0
    if _may_see_far(pose):
        offsets_ne_m = nadir_offsets(A_ne_pix, pose.p_ned_m, size)
        seen &= _near_enough(pose, offsets_ne_m, ground_up_m) & _in_front(pose, offsets_ne_m, ground_up_m)
    return image, seen


def rectify_surface(
    level: FrameLevel, pose: CameraPose, grid: MapGrid, behind: NDArray[np.bool_] | None = None
) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Frame on a map window over its surface model: (H, W) grey and the mask of what the frame shows unhidden.

    `behind` (H, W): what is `hidden`, where that is known from a pose nearby.
    """
    height, width = grid.weight.shape
    low, high = float(grid.surface_up_m.min()), float(grid.surface_up_m.max())
    if high - low < 0.05:
        return rectify_plane(level, pose, grid.A_ne_pix, (width, height), (low + high) / 2)
    base = ground_homography(level.K, pose, grid.A_ne_pix, low).astype(np.float32)
    per_metre = (-(level.K @ pose.R_ned_cam.T)[:, 2]).astype(np.float32)
    u, v = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    up = grid.surface_up_m - np.float32(low)
    x, y, z = ((base[k, 0] * u + base[k, 2])[None, :] + (base[k, 1] * v)[:, None] + per_metre[k] * up for k in range(3))
    ahead = z > 1e-3
    z = np.where(ahead, z, np.float32(1.0))
    map_u, map_v = x / z, y / z
    image = np.asarray(cv2.remap(level.grey, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)
    seen = (cv2.remap(level.valid, map_u, map_v, cv2.INTER_NEAREST, borderValue=0) > 0) & ahead
    if _may_see_far(pose):
        seen &= _near_enough(pose, nadir_offsets(grid.A_ne_pix, pose.p_ned_m, (width, height)), low)
    return image, seen & ~(hidden(pose, grid) if behind is None else behind)


def sampling_weight(
    K: FloatArray,
    pose: CameraPose,
    A_ne_pix: FloatArray,
    size: tuple[int, int],
    ground_up_m: float,
    pixel_m2: float | None = None,
) -> Float32Array | None:
    """(H, W) in 0..1: how well a frame samples each pixel of a grid of (width, height) pixels on a horizontal plane.

    `pixel_m2`: area of a pixel where that is not the grid's step (a thinned window).

    A frame pixel at depth q covers q^3 / (fx fy z) of a plane z below the camera. Where that is more than a grid pixel, the
    grid holds more pixels than there are measurements. None near nadir, where all would be alike.
    """
    if not _may_see_far(pose):
        return None
    z = np.float32(max(1.0, -float(pose.p_ned_m[2]) - ground_up_m))
    north, east = nadir_offsets(A_ne_pix, pose.p_ned_m, size)
    axis = pose.R_ned_cam[:, 2].astype(np.float32)
    depth = np.maximum(axis[0] * north + axis[1] * east + axis[2] * z, np.float32(0.05) * z)
    area_m2 = abs(np.linalg.det(A_ne_pix[:, :2])) if pixel_m2 is None else pixel_m2
    full = np.float32(FULL_SAMPLING * K[0, 0] * K[1, 1] * area_m2) * z
    return np.asarray(np.minimum(full / (depth * depth * depth), np.float32(1.0)), dtype=np.float32)


def nadir_offsets(A_ne_pix: FloatArray, p_ned_m: FloatArray, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """(H, W) metres north and east of each grid pixel from the camera's nadir."""
    u, v = np.arange(size[0], dtype=np.float32)[None, :], np.arange(size[1], dtype=np.float32)[:, None]
    a = A_ne_pix.astype(np.float32)
    c = (A_ne_pix[:, 2] - p_ned_m[:2]).astype(np.float32)
    return a[0, 0] * u + a[0, 1] * v + c[0], a[1, 0] * u + a[1, 1] * v + c[1]


def ground_points(grid: MapGrid, pix: FloatArray) -> FloatArray:
    """(N, 3) north, east, down (metres) of the surface at (N, 2) grid pixels, which may be none."""
    if not len(pix):
        return np.zeros((0, 3))
    u, v = pix[:, 0].astype(np.float32), pix[:, 1].astype(np.float32)
    up = cv2.remap(grid.surface_up_m, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.column_stack([apply_affine(grid.A_ne_pix, pix), -np.asarray(up, dtype=np.float64).ravel()])


def _may_see_far(pose: CameraPose) -> bool:
    return bool(pose.R_ned_cam[2, 2] < STEEP_COS)


def _near_enough(pose: CameraPose, offsets_ne_m: tuple[Float32Array, Float32Array], up_m: float) -> NDArray[np.bool_]:
    north, east = offsets_ne_m
    reach_m = MAX_TAN_INCIDENCE * max(1.0, -float(pose.p_ned_m[2]) - up_m)
    return np.asarray(north * north + east * east < reach_m * reach_m, dtype=np.bool_)


def _in_front(pose: CameraPose, offsets_ne_m: tuple[Float32Array, Float32Array], up_m: float) -> NDArray[np.bool_]:
    north, east = offsets_ne_m
    axis = pose.R_ned_cam[:, 2].astype(np.float32)
    return np.asarray(axis[0] * north + axis[1] * east + axis[2] * np.float32(-up_m - pose.p_ned_m[2]) > 0, dtype=np.bool_)


def hidden(pose: CameraPose, grid: MapGrid, steps: int = 8) -> NDArray[np.bool_]:
    """Pixels whose line to the camera passes under the surface: marched at a reduced resolution over the height that can hide."""
    stride = max(2, round(max(grid.weight.shape) / 120))
    surface = np.ascontiguousarray(grid.surface_up_m[::stride, ::stride])
    height, width = surface.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    linear = np.linalg.inv(grid.A_ne_pix[:, :2])
    nadir = (linear @ (pose.p_ned_m[:2] - grid.A_ne_pix[:, 2])) / stride
    camera_up = -float(pose.p_ned_m[2])
    highest = float(surface.max())
    below = np.maximum(camera_up - surface, 1.0)
    reach = np.clip((highest - surface) / below, 0, 1)
    found = np.zeros(surface.shape, np.bool_)
    for k in range(1, steps + 1):
        share = reach * (k / steps)
        su = u + (np.float32(nadir[0]) - u) * share
        sv = v + (np.float32(nadir[1]) - v) * share
        there = cv2.remap(surface, su, sv, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found |= there > surface + below * share + 1.0
    full = cv2.resize(found.astype(np.uint8), (grid.weight.shape[1], grid.weight.shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(full > 0, dtype=np.bool_)
