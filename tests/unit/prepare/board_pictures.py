"""Pictures of a board as a known camera sees it, through the project's own projection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.geo.camera import project, unproject
from visloc_companion.geo.lens import reach_tan
from visloc_companion.prepare.lens.board import Board
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import CameraModel, FloatArray, Image

BROWN = CameraModel(640, 480, 480.0, 478.0, 325.3, 236.1, (-0.30, 0.11, 0.0008, -0.0005, -0.02))
RATIONAL = CameraModel(640, 480, 400.0, 401.0, 316.0, 243.0, (0.9, 0.15, 0.0003, -0.0004, 0.005, 1.25, 0.4, 0.03), "rational")
FISHEYE = CameraModel(640, 480, 245.0, 246.0, 322.0, 238.0, (0.03, -0.012, 0.004, -0.0008), "fisheye")
"""Of 76, 94 and 150 degrees from side to side."""
LENSES = (BROWN, RATIONAL, FISHEYE)
_DOTS_A_MM, _MARGIN_MM, _RAYS_PX, _SAMPLES = 4, 8, 4, 2

Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Photographer:
    """Renders a board before a grey wall, with a soft lens and noise (grey levels)."""

    model: CameraModel
    board: Board

    def __post_init__(self) -> None:
        object.__setattr__(self, "_rays", _rays(self.model))
        object.__setattr__(self, "_sheet", _sheet(self.board))

    def __call__(self, pose: Pose, rng: np.random.Generator, noise: float = 2.0) -> Image:
        R, t = pose
        rays: FloatArray = self._rays @ R  # type: ignore[attr-defined]
        centre = t @ R
        away = centre[2] / rays[..., 2]
        at_mm = 1e3 * (rays[..., :2] * away[..., None] - centre[:2])
        at = np.where(away[..., None] > 0, (at_mm + _MARGIN_MM) * _DOTS_A_MM - 0.5, -1e4).astype(np.float32)
        seen = cv2.remap(self._sheet, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)  # type: ignore[attr-defined]
        seen = cv2.resize(seen, (self.model.width_px, self.model.height_px), interpolation=cv2.INTER_AREA).astype(np.float32)
        seen = 30 + 0.75 * cv2.GaussianBlur(seen, (0, 0), 0.6) + rng.normal(0, noise, seen.shape)
        return np.asarray(np.clip(seen, 0, 255), dtype=np.uint8)


def _rays(model: CameraModel) -> FloatArray:
    """(H, W, 3) unit rays of the samples, from those of every few pixels, between which they bend by less than a hundredth."""
    across, down = model.width_px // _RAYS_PX + 4, model.height_px // _RAYS_PX + 4
    v, u = (np.mgrid[0:down, 0:across] - 1.5) * _RAYS_PX - 0.5
    coarse = unproject(model, np.column_stack([u.ravel(), v.ravel()]))
    coarse /= np.linalg.norm(coarse, axis=1)[:, None]
    factor = _RAYS_PX * _SAMPLES
    fine = cv2.resize(coarse.reshape(down, across, 3), None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[2 * factor : -2 * factor, 2 * factor : -2 * factor])


def _sheet(board: Board) -> Image:
    size = [round(n * board.square_m * 1e3 * _DOTS_A_MM) for n in (board.columns, board.rows)]
    if board.kind == "charuco":
        drawn = board.charuco().generateImage(size, marginSize=0)
    else:
        v, u = np.mgrid[0 : size[1], 0 : size[0]] // round(board.square_m * 1e3 * _DOTS_A_MM)
        drawn = np.where((u + v) % 2 == 0, 0, 255).astype(np.uint8)
    drawn = cv2.GaussianBlur(drawn, (0, 0), 0.3 * _DOTS_A_MM)
    return np.asarray(cv2.copyMakeBorder(drawn, *[_MARGIN_MM * _DOTS_A_MM] * 4, cv2.BORDER_CONSTANT, value=255))


def poses(
    model: CameraModel, board: Board, n: int, rng: np.random.Generator, far: float = 1.0, tilt_deg: float = 35.0
) -> list[Pose]:
    """Rotations and shifts, board to camera: the board's middle anywhere in the picture, tilted by up to so much to any side."""
    made = []
    middle = np.array([board.columns, board.rows, 0]) * board.square_m / 2
    for _ in range(n):
        pix = rng.uniform(0.1, 0.9, 2) * (model.width_px, model.height_px)
        ray = unproject(model, pix[None])[0]
        ray /= np.linalg.norm(ray)
        away_m = far * board.columns * board.square_m * rng.uniform(0.6, 1.4) * 1.3 * max(model.fx_px / model.width_px, 0.35)
        axis = np.cross([0.0, 0.0, 1.0], ray)
        facing = cv2.Rodrigues(axis / np.linalg.norm(axis) * math.asin(np.linalg.norm(axis)) * 0.8)[0] if tilt_deg else np.eye(3)
        way, lean = rng.uniform(-math.pi, math.pi), math.radians(tilt_deg * rng.uniform(0.25, 1.0))
        leaning = cv2.Rodrigues(np.array([math.cos(way), math.sin(way), 0.0]) * lean)[0]
        R = facing @ leaning @ cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-0.6, 0.6)]))[0]
        made.append((R, ray * away_m - R @ middle))
    return made


def corners_seen(
    model: CameraModel,
    board: Board,
    pose: Pose,
    rng: np.random.Generator,
    sigma_px: float,
    warped: Callable[[FloatArray], FloatArray] = np.asarray,
) -> View:
    """The corners within the picture, with noise of their own, as a view of a sheet that may be `warped`; none is rendered."""
    R, t = pose
    at = warped(board.corners_m) @ R.T + t
    pix = project(model, at)
    inside = np.all((pix > 8) & (pix < (model.width_px - 9, model.height_px - 9)), axis=1) & (at[:, 2] > 0)
    ids = np.flatnonzero(inside & (np.hypot(at[:, 0], at[:, 1]) < reach_tan(model) * at[:, 2]))
    return View("", ids, board.corners_m[ids], pix[ids] + rng.normal(0, sigma_px, (len(ids), 2)))
