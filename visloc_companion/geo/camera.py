"""Pinhole camera with Brown-Conrady distortion, in numpy. `cam` is right, down, forward; `pix` as OpenCV."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np

from visloc_companion.types import CameraModel, FloatArray

R_FRD_CAM: FloatArray = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Camera looking along the body's down axis with the image's top edge forward: cam right = body right, cam down = body aft."""
FOCAL_SHARE = 0.015
"""1-sigma of the focal length: a lens that is focused, warm or calibrated in haste is off by a percent or two."""
RADII, NEWTON_STEPS, TANGENTIAL_PASSES = 2048, 3, 8
"""Of the inverse of the distortion: radii that are tabulated, steps from the tabulated one on, and how often what lies across the
radius is taken off."""
MOST_TAN = 1e3
_R2 = TypeVar("_R2", float, FloatArray)


def project(model: CameraModel, p_cam_m: FloatArray) -> FloatArray:
    """(N, 3) points in `cam` to (N, 2) pix. Points at or behind the camera give NaN."""
    z = np.where(p_cam_m[:, 2] > 1e-9, p_cam_m[:, 2], np.nan)
    return _pix_from_normalised(model, _distort(model, p_cam_m[:, :2] / z[:, None]))


def unproject(model: CameraModel, pix: FloatArray) -> FloatArray:
    """(N, 2) pix to (N, 3) ray directions in `cam` with third component 1 (not unit length).

    A pixel further out than the distortion's polynomial reaches (`reach_tan`) gets the ray at its reach.
    """
    xy = (pix - np.array([model.cx_px, model.cy_px])) / np.array([model.fx_px, model.fy_px])
    if any(model.distortion):
        xy = _undistorted(model, xy)
    return np.column_stack([xy, np.ones(len(xy))])


@lru_cache(maxsize=16)
def reach_tan(model: CameraModel) -> float:
    """Tangent of the angle off the optical axis beyond which the radial distortion folds back and shows what lies further in a
    second time; infinite where it never does."""
    k1, k2, _, _, k3 = model.distortion
    squares = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    turning = squares.real[(np.abs(squares.imag) < 1e-9) & (squares.real > 0)]
    return math.sqrt(float(turning.min())) if len(turning) else math.inf


def _undistorted(model: CameraModel, target: FloatArray) -> FloatArray:
    """The inverse of `_distort`: along the radius by a table and Newton, across it by repetition, as what is there is small."""
    xy = target
    for _ in range(TANGENTIAL_PASSES if any(model.distortion[2:4]) else 1):
        radial = target - _tangential(model, xy)
        distorted = np.hypot(radial[:, 0], radial[:, 1])
        xy = radial * (_undistorted_radius(model, distorted) / np.maximum(distorted, 1e-12))[:, None]
    return np.asarray(xy, dtype=np.float64)


def _undistorted_radius(model: CameraModel, distorted: FloatArray) -> FloatArray:
    """(N,) radii that the distortion takes to these; `reach_tan` where it takes none there."""
    k1, k2, _, _, k3 = model.distortion
    reach, farthest = min(reach_tan(model), MOST_TAN), float(distorted.max(initial=0.0))
    high = min(reach, max(farthest, 1e-3))
    while high < reach and high * _radial(model, high * high) < farthest:
        high = min(reach, 2 * high)
    table = np.linspace(0.0, high, RADII)
    r = np.interp(distorted, table * _radial(model, table * table), table)
    for _ in range(NEWTON_STEPS):
        r2 = r * r
        slope = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))
        r = np.clip(r - (r * _radial(model, r2) - distorted) / np.maximum(slope, 1e-6), 0.0, high)
    return np.asarray(r, dtype=np.float64)


def _distort(model: CameraModel, xy: FloatArray) -> FloatArray:
    if not any(model.distortion):
        return xy
    return np.asarray(xy * _radial(model, (xy * xy).sum(axis=1))[:, None] + _tangential(model, xy), dtype=np.float64)


def _radial(model: CameraModel, r2: _R2) -> _R2:
    """Factor on a radius of this square."""
    k1, k2, _, _, k3 = model.distortion
    return 1 + r2 * (k1 + r2 * (k2 + r2 * k3))


def _tangential(model: CameraModel, xy: FloatArray) -> FloatArray:
    """(N, 2) what a lens out of centre adds."""
    p1, p2 = model.distortion[2:4]
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    return np.column_stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def _pix_from_normalised(model: CameraModel, xy: FloatArray) -> FloatArray:
    return np.asarray(xy * np.array([model.fx_px, model.fy_px]) + np.array([model.cx_px, model.cy_px]), dtype=np.float64)


def scaled(model: CameraModel, factor: float) -> CameraModel:
    """The model of the same image resized by a factor (pixel centres: u' = (u + 0.5) factor - 0.5)."""
    return CameraModel(
        max(1, round(model.width_px * factor)),
        max(1, round(model.height_px * factor)),
        model.fx_px * factor,
        model.fy_px * factor,
        (model.cx_px + 0.5) * factor - 0.5,
        (model.cy_px + 0.5) * factor - 0.5,
        model.distortion,
    )
