"""Pinhole camera with Brown-Conrady distortion, in numpy. `cam` is right, down, forward; `pix` as OpenCV."""

from __future__ import annotations

import numpy as np

from visloc_companion.types import CameraModel, FloatArray

R_FRD_CAM: FloatArray = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Camera looking along the body's down axis with the image's top edge forward: cam right = body right, cam down = body aft."""
FOCAL_SHARE = 0.015
"""1-sigma of the focal length: a lens that is focused, warm or calibrated in haste is off by a percent or two."""


def project(model: CameraModel, p_cam_m: FloatArray) -> FloatArray:
    """(N, 3) points in `cam` to (N, 2) pix. Points at or behind the camera give NaN."""
    z = np.where(p_cam_m[:, 2] > 1e-9, p_cam_m[:, 2], np.nan)
    return _pix_from_normalised(model, _distort(model, p_cam_m[:, :2] / z[:, None]))


def unproject(model: CameraModel, pix: FloatArray) -> FloatArray:
    """(N, 2) pix to (N, 3) ray directions in `cam` with third component 1 (not unit length)."""
    target = (pix - np.array([model.cx_px, model.cy_px])) / np.array([model.fx_px, model.fy_px])
    xy = target.copy()
    if any(model.distortion):
        for _ in range(20):
            xy = xy + (target - _distort(model, xy))
    return np.column_stack([xy, np.ones(len(xy))])


def _distort(model: CameraModel, xy: FloatArray) -> FloatArray:
    k1, k2, p1, p2, k3 = model.distortion
    if not any(model.distortion):
        return xy
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
    )


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
