"""Coarse to fine for Lucas-Kanade without a search: the same features, low-passed less and less, then the working resolution.

A displacement is found only within about the reach of the low-pass (Baker & Matthews 2004, section 2), so the first levels see
little but large shapes. Features are computed at the resolution that they are made for and blurred after that: features of a
shrunk image lose the structure that lasts for years (training rows, footprint 173 px: 55 % within 5 px against 92 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from visloc_companion.localise.candidates.frame_features import FrameFeatures, Seen, frame_features, shown
from visloc_companion.localise.candidates.hypotheses import footprint_box
from visloc_companion.localise.features.base import Features, Float32Array
from visloc_companion.localise.frame import FrameLevel, full_level, reduced
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.mapped.window import map_grid
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan
from visloc_companion.localise.pose import PriorTerm, heading_from
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, FloatArray, Image, PosePrior


@dataclass(frozen=True, slots=True)
class Level:
    """One working resolution: side (px) of the square with the footprint's area, margin of the map's window (px), and the
    passes made there, each with the sigma (px) of its low-pass and its number of Gauss-Newton steps."""

    side_px: float
    margin_px: int
    passes: tuple[tuple[float, int], ...]


LEVELS = (Level(90.0, 26, ((8.0, 10), (6.0, 8), (4.5, 8), (3.0, 6), (2.0, 5), (1.0, 5))), Level(200.0, 8, ((0.0, 4),)))
"""Chosen on training rows; the first sigma is a sixth of the footprint's half side, about the published prior's ±20 of 173 px."""


@dataclass(frozen=True, slots=True, eq=False)
class LowPassed:
    """The frame's features after a Gaussian low-pass (localise.frame_features.FrameFeatures)."""

    inner: FrameFeatures
    sigma_px: float

    def on_plane(self, pose: CameraPose, A_ne_pix: FloatArray, size: tuple[int, int], ground_up_m: float) -> Seen:
        """See FrameFeatures."""
        values, mask = self.inner.on_plane(pose, A_ne_pix, size, ground_up_m)
        return low_passed(shown(values, mask), self.sigma_px), mask

    def on_surface(self, pose: CameraPose, grid: MapGrid) -> Seen:
        """See FrameFeatures."""
        values, mask = self.inner.on_surface(pose, grid)
        return low_passed(shown(values, mask), self.sigma_px), mask


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame about to be aligned: its plan, itself at full resolution, the start in the common local frame, the prior."""

    plan: SearchPlan
    full: FrameLevel
    start: CameraPose
    prior: PriorTerm

    def on(self, grid: MapGrid, features: Features) -> FrameFeatures:
        """The frame's features at the resolution of a window."""
        level = reduced(self.full, grid.gsd_m / self.plan.frame_gsd_m)
        return frame_features(level, self.plan, grid.A_ne_pix[:, :2], features)

    def gsd_m(self, level: Level, map_gsd_m: float) -> float:
        """Ground sample distance of a level, never finer than frame and map."""
        return max(self.plan.frame_gsd_m, map_gsd_m, math.sqrt(self.plan.area_m2) / level.side_px)


def view(pixels: Image, model: CameraModel, plan: SearchPlan, prior: PosePrior, local: LocalFrame) -> View:
    """A frame with its prior, the pose expressed in a common local frame (a few kilometres about the plan's own)."""
    own = plan.frame
    ne = np.linalg.solve(local.J_map_ne, own.origin_map + own.J_map_ne @ plan.pose.p_ned_m[:2] - local.origin_map)
    start = CameraPose(np.array([ne[0], ne[1], plan.pose.p_ned_m[2]]), plan.pose.R_ned_cam)
    up_m = -float(plan.pose.p_ned_m[2])
    term = PriorTerm(plan.pose.R_ned_cam, prior.sigma_tilt_rad, prior.sigma_yaw_rad, up_m, prior.sigma_h_m)
    return View(plan, full_level(pixels, model), start, term)


def window(view_: View, pose: CameraPose, level: Level, ref: ReferenceMap, local: LocalFrame, features: Features) -> MapGrid:
    """The map about what a pose sees, with the level's margin. Raises OutsideMap."""
    plan = view_.plan
    gsd_m = view_.gsd_m(level, ref.gsd_m)
    heading = heading_from(pose.R_ned_cam, plan.pose.R_ned_cam)
    scale = max(0.1, (-float(pose.p_ned_m[2]) - plan.ground_up_m) / plan.agl_m)
    low, high = footprint_box(plan, np.array([heading]), scale)
    margin_m: FloatArray = np.full(2, level.margin_px * gsd_m)
    return map_grid(ref, local, pose.p_ned_m[:2] + low - margin_m, pose.p_ned_m[:2] + high + margin_m, gsd_m, features)


def blurred(grid: MapGrid, sigma_px: float) -> MapGrid:
    """The window with its features low-passed."""
    return replace(grid, features=low_passed(grid.features, sigma_px))


def low_passed(features: Float32Array, sigma_px: float) -> Float32Array:
    """(H, W, C) features after a Gaussian low-pass; sigma 0 leaves them."""
    if sigma_px <= 0:
        return features
    return np.asarray(cv2.GaussianBlur(features, (0, 0), sigma_px), dtype=np.float32).reshape(features.shape)
