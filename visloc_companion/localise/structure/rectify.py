"""Rectification of a pair of down-looking frames: both drawn on one plane that holds the baseline, its normal as near to straight
down as that allows. Epipolar lines become rows whatever heading and tilt the frames have, and level ground has one disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.structure.view import View, level_axes, plane_outline
from visloc_companion.types import CameraModel, FloatArray, Image

UP_SHARE, DOWN_SHARE = 0.25, 0.05
"""Relief beyond that of the tracked points, above and below, as shares of the depth: tops of trees are seldom corners."""
MOST_DISPARITIES = 256


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedPair:
    """`left`, `right` (H, W) and where they show something; a left pixel (u, v) of depth Z lies at right u - (f B / Z - offset).

    `offset_px` is the smallest disparity planned for, `count` how many (a multiple of 16). The left window begins `count` pixels
    before the common ground, as the matcher cannot answer there.
    """

    view: View
    left: Image
    right: Image
    left_seen: NDArray[np.bool_]
    right_seen: NDArray[np.bool_]
    T_left: FloatArray
    baseline_m: float
    offset_px: float
    count: int

    def depth_m(self, disparity_px: FloatArray) -> FloatArray:
        """Depth along the view's axis of a disparity of the pictures."""
        return np.asarray(self.view.focal_px * self.baseline_m / (disparity_px + self.offset_px), dtype=np.float64)


def rectify(
    left: Image, right: Image, T_left: FloatArray, T_right: FloatArray, points: FloatArray, model: CameraModel
) -> RectifiedPair | None:
    """Draw a pair. `points` (N, 3) in `local` tell the relief to plan for. None where nothing is common."""
    baseline = T_right[:3, 3] - T_left[:3, 3]
    length = float(np.linalg.norm(baseline))
    axes = level_axes(baseline)
    focal = float(np.sqrt(model.fx_px * model.fy_px))
    depth = (points - T_left[:3, 3]) @ axes[:, 2]
    nearest, farthest = (float(d) for d in np.percentile(depth, (1, 99)))
    middle = float(np.median(depth))
    nearest, farthest = max(nearest - UP_SHARE * middle, 0.3 * middle), farthest + DOWN_SHARE * middle
    low, high = np.floor(focal * length / farthest), np.ceil(focal * length / nearest)
    count = int(min(-(-(high - low + 1) // 16) * 16, MOST_DISPARITIES))
    a, b = (plane_outline(model, axes.T @ T[:3, :3], focal) for T in (T_left, T_right))
    x0, x1 = max(a[:, 0].min(), b[:, 0].min() + low), min(a[:, 0].max(), b[:, 0].max() + high)
    y0, y1 = max(a[:, 1].min(), b[:, 1].min()), min(a[:, 1].max(), b[:, 1].max())
    if x1 - x0 < 32 or y1 - y0 < 32:
        return None
    corner = (float(np.floor(x0)) - count, float(np.floor(y0)))
    view = View(axes, focal, corner, (int(x1 - corner[0]) + 1, int(y1 - corner[1]) + 1))
    drawn_left, left_seen = view.render(left, model, T_left[:3, :3])
    drawn_right, right_seen = view.shifted(-float(low)).render(right, model, T_right[:3, :3])
    return RectifiedPair(view, drawn_left, drawn_right, left_seen, right_seen, T_left, length, float(low), count)


def seen_in_right(pair: RectifiedPair, disparity_px: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Left pixels whose place in the right picture, by their disparity, shows something."""
    height, width = disparity_px.shape
    u = np.arange(width, dtype=np.float32)[None, :] - disparity_px
    v = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], u.shape)
    there = cv2.remap(pair.right_seen.astype(np.uint8), u, np.ascontiguousarray(v), cv2.INTER_NEAREST, borderValue=0)
    return np.asarray(there > 0, dtype=np.bool_)
