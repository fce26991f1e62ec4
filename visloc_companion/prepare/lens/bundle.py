"""Lens and poses together by damped least squares (Levenberg and Marquardt, poses eliminated), from a lens that is roughly right.

OpenCV's own for fisheye lenses finds none of 178° (docs/decisions/0083-wide-lenses-are-fitted-here.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from visloc_companion.geo.camera import unproject
from visloc_companion.prepare.lens.view import Lens, View, all_residuals_px, residuals_px, slopes
from visloc_companion.types import CameraModel, FloatArray

_STEPS, _ENOUGH, _DAMPED, _MOST_DAMPED = 100, 1e-9, 1e-3, 1e9
_WIDEST_TAN = 5.0
"""Of the rays that tell a first pose: further out a lens that is roughly right is far off."""


def poses_under(model: CameraModel, views: Sequence[View]) -> FloatArray | None:
    """(V, 6) poses of the board where the lens is about this; None where a view gives none."""
    poses = []
    for view in views:
        rays = unproject(model, view.pix)[:, :2]
        near = np.hypot(*rays.T) < _WIDEST_TAN
        if near.sum() < 6:
            return None
        ok, turn, shift = cv2.solvePnP(view.board_m[near], rays[near], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not ok:
            return None
        poses.append(np.ravel([turn, shift]))
    return np.array(poses)


def cost(lens: Lens, views: Sequence[View]) -> float:
    """Sum of squared residuals, px²."""
    return sum(float(np.square(off).sum()) for off in all_residuals_px(lens, views))


def improved(lens: Lens, views: Sequence[View]) -> Lens:
    """The lens and poses of least squares next to these."""
    damped, now = _DAMPED, cost(lens, views)
    for _ in range(_STEPS):
        parts = [_normal(lens.model, pose, view) for pose, view in zip(lens.poses, views, strict=True)]
        before = now
        while damped < _MOST_DAMPED:
            tried = _stepped(lens, parts, damped)
            after = cost(tried, views)
            if after < now:
                lens, now, damped = tried, after, damped / 10
                break
            damped *= 10
        if not now < before * (1 - _ENOUGH):
            break
    return lens


Part = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _normal(model: CameraModel, pose: FloatArray, view: View) -> Part:
    """Normal equations of one view: of the pose, of both, of the lens, and their right-hand sides."""
    P, L = slopes(model, pose, view)
    r = residuals_px(model, pose, view).ravel()
    return P.T @ P, P.T @ L, L.T @ L, P.T @ r, L.T @ r


def _stepped(lens: Lens, parts: Sequence[Part], damped: float) -> Lens:
    n = parts[0][2].shape[0]
    whole, right = np.zeros((n, n)), np.zeros(n)
    held = []
    for pose_pose, pose_lens, lens_lens, pose_right, lens_right in parts:
        inverse = np.linalg.pinv(pose_pose + damped * np.diag(np.diag(pose_pose)))
        held.append(inverse)
        whole += lens_lens + damped * np.diag(np.diag(lens_lens)) - pose_lens.T @ inverse @ pose_lens
        right += lens_right - pose_lens.T @ inverse @ pose_right
    by = np.asarray(np.linalg.lstsq(whole, right, rcond=None)[0], dtype=np.float64)
    turned = [i @ (part[3] - part[1] @ by) for i, part in zip(held, parts, strict=True)]
    return Lens(_moved(lens.model, by), lens.poses + np.array(turned))


def _moved(model: CameraModel, by: FloatArray) -> CameraModel:
    fx, fy, cx, cy, *bent = (np.array([model.fx_px, model.fy_px, model.cx_px, model.cy_px, *model.distortion]) + by).tolist()
    return replace(model, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=tuple(bent))
