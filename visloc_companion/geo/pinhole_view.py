"""The pinhole camera that takes the place of a wide one: what is looked at behind the door (localise/around/rectified.py)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import project, unproject
from visloc_companion.geo.lens import radial_factor, reach_tan
from visloc_companion.types import CameraMask, CameraModel, FloatArray

WIDEST_HALF_DEG = 55.0
"""Off the axis, across and down. Further out ground is seen ever flatter, and a pinhole's picture grows without bound:
150° of a fisheye would be three times as wide at the same scale in the middle, and 180° endless."""
INSIDE = 0.999
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
ROWS = 64
"""Of a mask, so many are looked up at a time: all of a large picture at once would take gigabytes."""


@lru_cache(maxsize=16)
def pinhole_view(model: CameraModel) -> CameraModel:
    """The pinhole camera at the same place and attitude whose picture a rational or fisheye camera's frames are turned into; a
    Brown-Conrady camera stays as it is.

    It keeps the scale of the middle (`fx_px`, `fy_px`), so that nothing that the sensor resolves there is lost; its size is
    that of the largest upright picture which the frame fills to its corners, at most 55° off the axis to each side. A mask
    is turned as the frames are.
    """
    if model.distortion_model == "brown_conrady":
        return model
    low, high = _inscribed(model)
    focal = np.array([model.fx_px, model.fy_px])
    width, height = (max(1, math.floor(extent)) for extent in ((high - low) * focal).tolist())
    cx, cy = (-low * focal).tolist()
    view = replace(
        model,
        width_px=width,
        height_px=height,
        cx_px=cx,
        cy_px=cy,
        distortion=NO_DISTORTION,
        distortion_model="brown_conrady",
        mask=None,
    )
    return view if model.mask is None else replace(view, mask=_seen_by(view, model, model.mask.ground()))


def field_of_view_deg(model: CameraModel) -> tuple[float, float]:
    """Angle that the camera sees along its middle row and its middle column."""
    row, column = (model.height_px - 1) / 2, (model.width_px - 1) / 2
    ends = np.array([[-0.5, row], [model.width_px - 0.5, row], [column, -0.5], [column, model.height_px - 0.5]])
    rays = unproject(model, ends)
    left, right, top, bottom = np.degrees(np.arctan([*rays[:2, 0], *rays[2:, 1]])).tolist()
    return right - left, bottom - top


def inner_reach(model: CameraModel) -> float:
    """How far the lens's mapping reaches before it folds, as a share of the way from the principal point to the nearest border
    of the picture; infinite where it never folds."""
    turning = reach_tan(model)
    if not math.isfinite(turning):
        return math.inf
    nearest = min(model.cx_px + 0.5, model.width_px - 0.5 - model.cx_px) / model.fx_px
    nearest = min(nearest, min(model.cy_px + 0.5, model.height_px - 0.5 - model.cy_px) / model.fy_px)
    return _distorted(model, turning) / nearest


def why_folded(model: CameraModel) -> str | None:
    """What is wrong with a lens whose mapping folds between the principal point and the nearest border: its coefficients are
    another lens's, or in another order. None where it does not fold there."""
    if (reach := inner_reach(model)) >= 1.0:
        return None
    return (
        f"the mapping of this {model.distortion_model} lens folds back within the picture, "
        f"at {100 * reach:.0f} % of the way from the principal point to the nearest border"
    )


def _seen_by(view: CameraModel, model: CameraModel, ground: NDArray[np.bool_]) -> CameraMask:
    """The mask of `model`, (H, W) true for ground, as a pinhole of the same place and attitude sees it."""
    seen = np.zeros((view.height_px, view.width_px), np.bool_)
    for first in range(0, view.height_px, ROWS):
        v, u = np.mgrid[first : min(first + ROWS, view.height_px), 0 : view.width_px]
        pix = np.round(project(model, unproject(view, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))))
        column, row = np.clip(pix, 0, (model.width_px - 1, model.height_px - 1)).astype(np.intp).T
        seen[first : first + ROWS] = ground[row, column].reshape(u.shape)
    return CameraMask.of(seen)


def _distorted(model: CameraModel, r: float) -> float:
    return r * float(radial_factor(model, np.array(r * r)))


def _inscribed(model: CameraModel) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest (x, y) of the upright rectangle, on the plane at unit distance, all of which the frame shows."""
    w, h = model.width_px - 1.0, model.height_px - 1.0
    u, v = np.arange(model.width_px, dtype=np.float64), np.arange(model.height_px, dtype=np.float64)
    left, right = (unproject(model, np.column_stack([np.full(len(v), at), v]))[:, 0] for at in (0.0, w))
    top, bottom = (unproject(model, np.column_stack([u, np.full(len(u), at)]))[:, 1] for at in (0.0, h))
    widest = math.tan(math.radians(WIDEST_HALF_DEG))
    low = np.maximum([left.max(), top.max()], -widest)
    high = np.minimum([right.min(), bottom.min()], widest)
    corner = float(np.hypot(*np.maximum(np.abs(low), np.abs(high))))
    within = min(1.0, INSIDE * reach_tan(model) / corner)
    return low * within, high * within
