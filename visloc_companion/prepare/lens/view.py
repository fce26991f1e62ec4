"""What a fit is made from and of: views of the board, a lens with poses, and by how much they disagree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import pinhole_matrix, project
from visloc_companion.types import CameraModel, FloatArray

_POSE_STEPS = 15
_FOLDED_PX = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A picture of the board: numbers of its corners (N,), where they are on the board (N, 3) metres and in it (N, 2) `pix`."""

    name: str
    ids: NDArray[np.int64]
    board_m: FloatArray
    pix: FloatArray
    edge_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A fitted camera and (V, 6) poses of the board in its views: a rotation vector and metres, board to camera."""

    model: CameraModel
    poses: FloatArray


def residuals_px(model: CameraModel, pose: FloatArray, view: View) -> FloatArray:
    """(N, 2) by how much corners are seen beside where the lens shows them, in the project's own projection."""
    turn, _ = cv2.Rodrigues(pose[:3])
    shown = project(model, view.board_m @ turn.T + pose[3:])
    return np.where(np.isfinite(shown), view.pix - shown, _FOLDED_PX)


def all_residuals_px(lens: Lens, views: Sequence[View]) -> list[FloatArray]:
    """(N, 2) of each view that a lens was fitted to."""
    return [residuals_px(lens.model, pose, view) for pose, view in zip(lens.poses, views, strict=True)]


def slopes(model: CameraModel, pose: FloatArray, view: View) -> tuple[FloatArray, FloatArray]:
    """(2N, 6) and (2N, 4 + K) derivatives of where corners are shown by the pose, and by fx, fy, cx, cy and the coefficients."""
    K, bent = pinhole_matrix(model), np.array(model.distortion)
    points = view.board_m.reshape(-1, 1, 3)
    if model.distortion_model == "fisheye":
        J = cv2.fisheye.projectPoints(points, pose[:3].reshape(3, 1), pose[3:].reshape(3, 1), K, bent)[1]
        return _of_64(J[:, 8:14]), _of_64(J[:, :8])
    J = cv2.projectPoints(points, pose[:3], pose[3:], K, bent)[1]
    return _of_64(J[:, :6]), _of_64(J[:, 6 : 10 + len(bent)])


def beside_poses(
    lens: Lens, views: Sequence[View], more: Callable[[FloatArray, View], FloatArray] | None = None
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Normal matrices (K, K) and right-hand sides (K,) of each view, of the lens's numbers and of those that `more` gives the
    (2N, M) derivatives by, for a pose and its view: of what no other pose of the board would explain."""
    told, pulls = [], []
    for pose, view in zip(lens.poses, views, strict=True):
        by_pose, by_lens = slopes(lens.model, pose, view)
        basis, _ = np.linalg.qr(by_pose)
        asked = by_lens if more is None else np.column_stack([by_lens, more(pose, view)])
        free = asked - basis @ (basis.T @ asked)
        told.append(free.T @ free)
        pulls.append(free.T @ residuals_px(lens.model, pose, view).ravel())
    return told, pulls


def _of_64(values: NDArray[Any]) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def placed(model: CameraModel, pose: FloatArray, view: View) -> FloatArray:
    """The pose of a view under a lens that was fitted without it, from a pose near by: Gauss and Newton, halved where it errs."""
    best = float(np.square(residuals_px(model, pose, view)).sum())
    for _ in range(_POSE_STEPS):
        by_pose, _ = slopes(model, pose, view)
        step = np.linalg.lstsq(by_pose, residuals_px(model, pose, view).ravel(), rcond=None)[0]
        tries = [pose + step * share for share in (1.0, 0.5, 0.1)]
        costs = [float(np.square(residuals_px(model, tried, view)).sum()) for tried in tries]
        if not min(costs) < best * (1 - 1e-9):
            break
        best, pose = min(costs), tries[int(np.argmin(costs))]
    return pose
