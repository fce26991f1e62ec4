"""Features of the frame for any pose: computed for each, or computed a few times and resampled.

A network's pass is dear, so it is run once on the frame rectified for the middle of a range of headings and scales, and its
features are then resampled as if they were the picture of a camera at the same place: the raster of a plane and the frame are
related by a homography, which takes the place of the calibration matrix. A descent moves so little that it needs one pass of any
features.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.align import smoothed
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
from visloc_companion.localise.pose import heading_from
from visloc_companion.types import FloatArray

Seen = tuple[Float32Array, Float32Array]
"""Features (H, W, C) and the weight (H, W) in 0..1: 0 where the frame shows nothing, whatever the features are there (`shown`),
less than 1 where it samples thinly."""


class FrameFeatures(Protocol):
    """The frame's features on a plane or on the map's surface, seen from a pose."""

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """Features on a grid of (width, height) pixels over a horizontal plane."""
        ...

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """Features on a map window over its surface."""
        ...


class SearchedFeatures(FrameFeatures, Protocol):
    """Features that a search asks for over all of a plan."""

    def compute_all(self) -> None:
        """Compute all that is kept, for any pose of the plan: from then on threads may ask at the same time."""
        ...


class DescentFeatures(SearchedFeatures, Protocol):
    """Features that a descent can be given at once."""

    def about(self, pose: CameraPose, grid: MapGrid, stride: int) -> FramePass:
        """Low-passed features to be resampled for poses that see about the same of a map window thinned by `stride`."""
        ...


def frame_features(level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features) -> DescentFeatures:
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

    def compute_all(self) -> None:
        """See SearchedFeatures: nothing is kept."""

    def about(self, pose: CameraPose, grid: MapGrid, stride: int) -> FramePass:
        """See DescentFeatures."""
        size = grid.weight.shape[1] * stride, grid.weight.shape[0] * stride
        A_ne_pix = grid.A_ne_pix / np.array([stride, stride, 1.0])
        return smooth(_computed(self.level, pose, A_ne_pix, size, float(grid.surface_up_m.mean()), self.features))

    def _of(self, image: Float32Array, seen: NDArray[np.bool_]) -> Seen:
        return self.features(image, seen), eroded(seen, 3)


@dataclass(frozen=True, slots=True, eq=False)
class FramePass:
    """Features computed at once for a pose, and resampled for poses near it.

    `level` holds the features as a picture from the pose's place, `K` is the frame's own calibration matrix, `oriented` as in
    Features.
    """

    level: FrameLevel
    R_ned_cam: FloatArray
    K: FloatArray
    oriented: int

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """See FrameFeatures."""
        values, seen = rectify_plane(self.level, pose, A_ne_pix, size, ground_up_m)
        mask = seen.astype(np.float32)
        return self._turned(values, pose), sampled(mask, self.K, pose, A_ne_pix, ground_up_m)

    def on_surface(self, pose: CameraPose, grid: MapGrid, behind: NDArray[np.bool_] | None = None) -> Seen:
        """See FrameFeatures. The window may be thinned; `behind` is what is known to be hidden."""
        values, seen = rectify_surface(self.level, pose, grid, behind)
        mask = seen.astype(np.float32)
        return self._turned(values, pose), sampled(
            mask, self.K, pose, grid.A_ne_pix, float(grid.surface_up_m.mean()), grid.gsd_m**2
        )

    def _turned(self, values: Float32Array, pose: CameraPose) -> Float32Array:
        """Oriented channels turned from the pass to the pose, in their place."""
        turn_rad = heading_from(pose.R_ned_cam, self.R_ned_cam)
        values[..., : 2 * self.oriented].view(np.complex64)[:] *= np.complex64(cmath.exp(2j * turn_rad))
        return values


class Resampled:
    """Features computed for the middles of ranges of heading and scale, and resampled for poses within; each middle's when a pose
    first asks for it: a search asks for all, what refines a few of its places for one or two."""

    def __init__(
        self, level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features, tolerance: tuple[float, float]
    ) -> None:
        self._plan = plan
        self._headings = _middles(plan.headings_rad, tolerance[0])
        self._log_scales = _middles(np.log(plan.scales), tolerance[1])
        self._compute = partial(_pass_of, level, plan, linear, features)
        self._passes: dict[tuple[int, int], FramePass] = {}
        self._smooth: dict[tuple[int, int], FramePass] = {}

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """See FrameFeatures."""
        return self._pass(self._nearest(pose)).on_plane(pose, A_ne_pix, size, ground_up_m)

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """See FrameFeatures."""
        return self._pass(self._nearest(pose)).on_surface(pose, grid)

    def about(self, pose: CameraPose, grid: MapGrid, stride: int) -> FramePass:
        """See DescentFeatures."""
        nearest = self._nearest(pose)
        if nearest not in self._smooth:
            self._smooth[nearest] = smooth(self._pass(nearest))
        return self._smooth[nearest]

    def compute_all(self) -> None:
        """See SearchedFeatures."""
        for which in product(range(len(self._headings)), range(len(self._log_scales))):
            self._pass(which)

    def _pass(self, which: tuple[int, int]) -> FramePass:
        if which not in self._passes:
            heading_rad, log_scale = float(self._headings[which[0]]), float(self._log_scales[which[1]])
            self._passes[which] = self._compute(heading_rad, math.exp(log_scale))
        return self._passes[which]

    def _nearest(self, pose: CameraPose) -> tuple[int, int]:
        """Which pass, of heading and scale, is nearest a pose."""
        heading = heading_from(pose.R_ned_cam, self._plan.pose.R_ned_cam)
        apart = np.mod(heading - self._headings + math.pi, 2 * math.pi) - math.pi
        up_m = max(1.0, -float(pose.p_ned_m[2]) - self._plan.ground_up_m)
        return int(np.abs(apart).argmin()), int(np.abs(math.log(up_m / self._plan.agl_m) - self._log_scales).argmin())


def shown(values: Float32Array, weight: Float32Array) -> Float32Array:
    """Features (H, W, C) with zeros where the frame shows nothing: before anything is taken from a pixel's neighbours."""
    return np.where(weight[..., None] > 0, values, np.float32(0))


def smooth(computed: FramePass) -> FramePass:
    """The pass with its features low-passed as the alignment wants them."""
    return replace(computed, level=replace(computed.level, grey=smoothed(computed.level.grey)))


def sampled(
    mask: Float32Array,
    K: FloatArray,
    pose: CameraPose,
    A_ne_pix: FloatArray,
    ground_up_m: float,
    pixel_m2: float | None = None,
) -> Float32Array:
    """The mask (H, W) weighted by how well a frame of calibration matrix K samples the ground in pixels of an area."""
    weight = sampling_weight(K, pose, A_ne_pix, (mask.shape[1], mask.shape[0]), ground_up_m, pixel_m2)
    return mask if weight is None else mask * weight


def _pass_of(
    level: FrameLevel, plan: SearchPlan, linear: FloatArray, features: Features, heading_rad: float, scale: float
) -> FramePass:
    """Features of the frame rectified for a heading and scale."""
    pose = CameraPose(np.array([0.0, 0.0, -plan.ground_up_m - plan.agl_m * scale]), turned(plan.pose.R_ned_cam, heading_rad))
    A_ne_pix, size = plane_raster(plan, linear, heading_rad, scale)
    return _computed(level, pose, A_ne_pix, size, plan.ground_up_m, features)


def _computed(
    level: FrameLevel, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float, features: Features
) -> FramePass:
    """Features of the frame rectified for a pose, with the matrix that makes them a picture from the same place."""
    image, seen = rectify_plane(level, pose, A_ne_pix, size, ground_up_m)
    valid = (eroded(seen, 3) > 0).astype(np.uint8) * np.uint8(255)
    K = np.linalg.inv(ground_homography(level.K, pose, A_ne_pix, ground_up_m)) @ level.K
    picture = FrameLevel(features(image, seen), valid, K / float(K[2] @ pose.R_ned_cam.T[:, 2]))
    return FramePass(picture, pose.R_ned_cam, level.K, features.oriented)


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
