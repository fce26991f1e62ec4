"""Whether the sheet was flat, and printed alike across and down. One that was not fits almost as well, with another focal length:
no residual says so by itself.

What it may be, the same in every view, is let free beside the lens for one step of the fit: bent across, bent down, twisted, and
stretched (OpenCV's calibrateCameraRO lets every corner free; Strobl and Hirzinger 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.geo.camera import project
from visloc_companion.prepare.lens.board import Board
from visloc_companion.prepare.lens.view import Lens, View, beside_poses
from visloc_companion.types import FloatArray

SURE = 18.5
"""Chi-squared of four numbers that one good sheet of a thousand exceeds."""
_NUDGE_M, _SHAPES = 1e-5, 4


@dataclass(frozen=True, slots=True)
class Warp:
    """`bent_m`: from the lowest to the highest of the sheet's corners; `stretched`: by what share it is longer across than down;
    `focal_share`: by what share a focal length was wrong for both (the larger of both axes'); `sure`: whether the views tell the
    sheet from a good one."""

    bent_m: float
    stretched: float
    focal_share: float
    sure: bool


_GOOD = Warp(0.0, 0.0, 0.0, False)


def warp(lens: Lens, views: Sequence[View], board: Board) -> Warp:
    """How the sheet was bent and stretched, as far as the views tell."""
    told, pulls = beside_poses(lens, views, lambda pose, view: _by_shape(lens, pose, view, board))
    whole, pull, n = np.sum(told, axis=0), np.sum(pulls, axis=0), len(views)
    try:
        step = np.linalg.solve(whole, pull)
        shape = step[-_SHAPES:]
        apart = np.array([np.linalg.solve(whole - a, pull - g) - step for a, g in zip(told, pulls, strict=True)])[:, -_SHAPES:]
        chi2 = float(shape @ np.linalg.solve((n - 1) / n * apart.T @ apart, shape))
    except np.linalg.LinAlgError:
        return _GOOD
    surface = _heights(board, board.corners_m) @ shape[:-1]
    level = np.column_stack([board.corners_m[:, :2], np.ones(len(surface))])
    surface -= level @ np.linalg.lstsq(level, surface, rcond=None)[0]
    focal_share = max(abs(step[0]) / lens.model.fx_px, abs(step[1]) / lens.model.fy_px)
    return Warp(float(np.ptp(surface)), float(shape[-1]), float(focal_share), chi2 > SURE)


def _heights(board: Board, at_m: FloatArray) -> FloatArray:
    """(N, 3) heights, 1 m at the most, of a sheet that is bent across, bent down, and twisted."""
    u, v = _from_middle(board, at_m).T
    return np.column_stack([1 - u * u, 1 - v * v, u * v])


def _from_middle(board: Board, at_m: FloatArray) -> FloatArray:
    half = np.array([board.columns, board.rows]) * board.square_m / 2
    return np.asarray((at_m[:, :2] - half) / half)


def _by_shape(lens: Lens, pose: FloatArray, view: View, board: Board) -> FloatArray:
    """(2N, 4) derivatives of where corners are shown by those heights, and by the share that the sheet is longer across."""
    turn, _ = cv2.Rodrigues(pose[:3])
    at = view.board_m @ turn.T + pose[3:]
    out, across = (
        (project(lens.model, at + nudge) - project(lens.model, at - nudge)) / (2 * _NUDGE_M)
        for nudge in (_NUDGE_M * turn[:, 2], _NUDGE_M * turn[:, 0])
    )
    heights, stretch_m = (
        _heights(board, view.board_m),
        _from_middle(board, view.board_m)[:, 0] * board.columns * board.square_m / 2,
    )
    moved = np.concatenate([out[:, :, None] * heights[:, None, :], (across * stretch_m[:, None])[:, :, None]], axis=2)
    return np.asarray(moved.reshape(-1, _SHAPES), dtype=np.float64)
