"""Features of the frame for any pose: computed for each, or computed a few times and resampled.

A network's pass is dear, so it is run once on the frame rectified for the middle of a range of headings and scales, and its
features are then resampled as if they were the picture of a camera at the same place: the raster of a plane and the frame are
related by a homography, which takes the place of the calibration matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Features, Float32Array
from visloc_companion.localise.features.gradient import eroded
from visloc_companion.localise.frame import FrameLevel
from visloc_companion.localise.ortho_rectify import (
    CameraPose,
    MapGrid,
    ground_homography,
    rectify_plane,
    rectify_surface,
    sampling_weight,
)
from visloc_companion.localise.plan import SearchPlan, turned
from visloc_companion.localise.pose import heading_and_tilt
from visloc_companion.types import FloatArray

Seen = tuple[Float32Array, Float32Array]
"""Features (H, W, C) and the weight (H, W) in 0..1: 0 where the frame shows nothing, less than 1 where it samples thinly."""


class FrameFeatures(Protocol):
    """The frame's features on a plane or on the map's surface, seen from a pose."""

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """Features on a grid of (width, height) pixels over a horizontal plane."""
        ...

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """Features on a map window over its surface."""
        ...


def frame_features(level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features) -> FrameFeatures:
    """The frame's features at a level; `linear` (2, 2): metres north, east of a step of one grid pixel in u, v."""
    if features.tolerance is None:
        return ForEachPose(level, features)
    return Resampled(level, plan, linear, features, features.tolerance)


@dataclass(frozen=True, slots=True, eq=False)
class ForEachPose:
    """Features computed anew on the frame rectified for the pose."""

    level: FrameLevel
    features: Features

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """See FrameFeatures."""
        values, mask = self._of(*rectify_plane(self.level, pose, A_ne_pix, size, ground_up_m))
        return values, sampled(mask, self.level.K, pose, A_ne_pix, ground_up_m)

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """See FrameFeatures."""
        values, mask = self._of(*rectify_surface(self.level, pose, grid))
        return values, sampled(mask, self.level.K, pose, grid.A_ne_pix, float(grid.surface_up_m.mean()))

    def _of(self, image: Float32Array, seen: NDArray[np.bool_]) -> Seen:
        return self.features(image, seen), eroded(seen, 3)


class Resampled:
    """Features computed at once for the middles of ranges of heading and scale, and resampled for poses within."""

    def __init__(
        self, level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features, tolerance: tuple[float, float]
    ) -> None:
        self._plan, self._features, self._K = plan, features, level.K
        self._headings = _middles(plan.headings_rad, tolerance[0])
        self._log_scales = _middles(np.log(plan.scales), tolerance[1])
        self._passes = [
            [_computed(level, plan, linear, features, float(h), math.exp(s)) for s in self._log_scales] for h in self._headings
        ]

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """See FrameFeatures."""
        level, turn = self._nearest(pose)
        values, mask = self._turned(*rectify_plane(level, pose, A_ne_pix, size, ground_up_m), turn)
        return values, sampled(mask, self._K, pose, A_ne_pix, ground_up_m)

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """See FrameFeatures."""
        level, turn = self._nearest(pose)
        values, mask = self._turned(*rectify_surface(level, pose, grid), turn)
        return values, sampled(mask, self._K, pose, grid.A_ne_pix, float(grid.surface_up_m.mean()))

    def _nearest(self, pose: CameraPose) -> tuple[FrameLevel, float]:
        """The pass nearest a pose, and how far the pose is turned against it."""
        heading, _ = heading_and_tilt(pose.R_ned_cam, self._plan.pose.R_ned_cam)
        apart = np.mod(heading - self._headings + math.pi, 2 * math.pi) - math.pi
        up_m = max(1.0, -float(pose.p_ned_m[2]) - self._plan.ground_up_m)
        i, j = int(np.abs(apart).argmin()), int(np.abs(math.log(up_m / self._plan.agl_m) - self._log_scales).argmin())
        return self._passes[i][j], float(apart[i])

    def _turned(self, values: Float32Array, seen: NDArray[np.bool_], turn_rad: float) -> Seen:
        mask = seen.astype(np.float32)
        c, s = np.float32(math.cos(2 * turn_rad)), np.float32(math.sin(2 * turn_rad))
        for k in range(0, 2 * self._features.oriented, 2):
            x, y = values[..., k].copy(), values[..., k + 1].copy()
            values[..., k], values[..., k + 1] = c * x - s * y, s * x + c * y
        return values * mask[..., None], mask


def sampled(mask: Float32Array, K: FloatArray, pose: CameraPose, A_ne_pix: FloatArray, ground_up_m: float) -> Float32Array:
    """The mask (H, W) weighted by how well a frame of calibration matrix K samples the ground."""
    weight = sampling_weight(K, pose, A_ne_pix, (mask.shape[1], mask.shape[0]), ground_up_m)
    return mask if weight is None else mask * weight


def _computed(
    level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features, heading_rad: float, scale: float
) -> FrameLevel:
    """Features of the frame rectified for a heading and scale, with the matrix that makes them a picture from the same place."""
    pose = CameraPose(np.array([0.0, 0.0, -plan.ground_up_m - plan.agl_m * scale]), turned(plan.pose.R_ned_cam, heading_rad))
    A_ne_pix, size = plane_raster(plan, linear, heading_rad, scale)
    image, seen = rectify_plane(level, pose, A_ne_pix, size, plan.ground_up_m)
    valid = (eroded(seen, 3) > 0).astype(np.uint8) * np.uint8(255)
    K = np.linalg.inv(ground_homography(level.K, pose, A_ne_pix, plan.ground_up_m)) @ level.K
    return FrameLevel(features(image, seen), valid, K / float(K[2] @ pose.R_ned_cam.T[:, 2]))


def plane_raster(plan: SearchPlan, linear: FloatArray, heading_rad: float, scale: float) -> tuple[FloatArray, tuple[int, int]]:
    """(2, 3) pix -> metres north, east of the nadir, and (width, height), of the raster that holds a hypothesis' footprint.

    The nadir lies on a whole pixel (outside the raster where the camera looks far ahead).
    """
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    outline = scale * plan.footprint_ne_m @ np.array([[c, s], [-s, c]]) @ np.linalg.inv(linear).T
    first, last = np.floor(outline.min(0)).astype(int), np.ceil(outline.max(0)).astype(int)
    return np.column_stack([linear, linear @ first]), (int(last[0] - first[0] + 1), int(last[1] - first[1] + 1))


def _middles(values: FloatArray, reach: float) -> FloatArray:
    """Middles of the fewest equal ranges of at most ±reach that cover the values (a full circle closes)."""
    low, high = float(values.min()), float(values.max())
    n = max(1, math.ceil((high - low) / (2 * reach) - 1e-9))
    return np.asarray(low + (np.arange(n) + 0.5) * (high - low) / n, dtype=np.float64)
