"""Cameras whose lenses bend (geo/lens.py), in numpy. `cam` is right, down, forward; `pix` as OpenCV."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from visloc_companion.geo.lens import is_bent, is_off_centre, radial_factor, radial_slope, reach_tan, tangential
from visloc_companion.types import CameraModel, FloatArray

R_FRD_CAM: FloatArray = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Camera looking along the body's down axis with the image's top edge forward: cam right = body right, cam down = body aft."""
FOCAL_SHARE = 0.015
"""1-sigma of the focal length: a lens that is focused, warm or calibrated in haste is off by a percent or two."""
RADII, NEWTON_STEPS, TANGENTIAL_PASSES = 2048, 3, 8
"""Of the inverse of the distortion: radii that are tabulated, steps from the tabulated one on, and how often what lies across the
radius is taken off."""
MOST_TAN = 1e3


def project(model: CameraModel, p_cam_m: FloatArray) -> FloatArray:
    """(N, 3) points in `cam` to (N, 2) pix. Points at or behind the camera give NaN."""
    z = np.where(p_cam_m[:, 2] > 1e-9, p_cam_m[:, 2], np.nan)
    return _pix_from_normalised(model, _distort(model, p_cam_m[:, :2] / z[:, None]))


def unproject(model: CameraModel, pix: FloatArray) -> FloatArray:
    """(N, 2) pix to (N, 3) ray directions in `cam` with third component 1 (not unit length).

    A pixel further out than the distortion (`reach_tan`) gets the ray at its reach.
    """
    xy = (pix - np.array([model.cx_px, model.cy_px])) / np.array([model.fx_px, model.fy_px])
    if is_bent(model):
        xy = _undistorted(model, xy)
    return np.column_stack([xy, np.ones(len(xy))])


def _undistorted(model: CameraModel, target: FloatArray) -> FloatArray:
    """The inverse of `_distort`: along the radius by a table and Newton, across it by repetition, as what is there is small."""
    xy = target
    for _ in range(TANGENTIAL_PASSES if is_off_centre(model) else 1):
        radial = target - tangential(model, xy)
        distorted = np.hypot(radial[:, 0], radial[:, 1])
        xy = radial * (_undistorted_radius(model, distorted) / np.maximum(distorted, 1e-12))[:, None]
    return np.asarray(xy, dtype=np.float64)


def _undistorted_radius(model: CameraModel, distorted: FloatArray) -> FloatArray:
    """(N,) radii that the distortion takes to these; `reach_tan` where it takes none there."""
    reach, farthest = min(reach_tan(model), MOST_TAN), float(distorted.max(initial=0.0))
    high = min(reach, max(farthest, 1e-3))
    while high < reach and high * float(radial_factor(model, np.array(high * high))) < farthest:
        high = min(reach, 2 * high)
    brown = model.distortion_model == "brown_conrady"
    table = np.linspace(0.0, high, RADII) if brown else np.tan(np.linspace(0.0, np.arctan(high), RADII))
    r = np.interp(distorted, table * radial_factor(model, table * table), table)
    for _ in range(NEWTON_STEPS):
        r2 = r * r
        slope = radial_slope(model, r2)
        r = np.clip(r - (r * radial_factor(model, r2) - distorted) / np.maximum(slope, 1e-6), 0.0, high)
    return np.asarray(r, dtype=np.float64)


def _distort(model: CameraModel, xy: FloatArray) -> FloatArray:
    if not is_bent(model):
        return xy
    return np.asarray(xy * radial_factor(model, (xy * xy).sum(axis=1))[:, None] + tangential(model, xy), dtype=np.float64)


def _pix_from_normalised(model: CameraModel, xy: FloatArray) -> FloatArray:
    return np.asarray(xy * np.array([model.fx_px, model.fy_px]) + np.array([model.cx_px, model.cy_px]), dtype=np.float64)


def pinhole_matrix(model: CameraModel) -> FloatArray:
    """(3, 3) of focal lengths and principal point."""
    return np.array([[model.fx_px, 0.0, model.cx_px], [0.0, model.fy_px, model.cy_px], [0.0, 0.0, 1.0]])


def scaled(model: CameraModel, factor: float) -> CameraModel:
    """The model, and with it the mask, of the same image resized by a factor, to whole pixels: across and down by what that makes
    of it (pixel centres: u' = (u + 0.5) across - 0.5)."""
    width_px, height_px = max(1, round(model.width_px * factor)), max(1, round(model.height_px * factor))
    across, down = width_px / model.width_px, height_px / model.height_px
    return replace(
        model,
        width_px=width_px,
        height_px=height_px,
        fx_px=model.fx_px * across,
        fy_px=model.fy_px * down,
        cx_px=(model.cx_px + 0.5) * across - 0.5,
        cy_px=(model.cy_px + 0.5) * down - 0.5,
        mask=None if model.mask is None else model.mask.reduced(width_px, height_px),
    )
