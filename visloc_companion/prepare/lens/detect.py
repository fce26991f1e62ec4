"""Where in a picture the corners of a board are, and what may be the matter with a picture in which none are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.prepare.lens.board import Board
from visloc_companion.types import FloatArray, Image

LEAST_CORNERS = 10
"""Six numbers of a pose are spent on each view: with 20 of its corners' coordinates something is left to learn of the lens."""
_FAMILIES = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36H12", "APRILTAG_36H11")
_LEAST_MARKERS = 4
_WINDOW_SHARES, _WINDOW_PX = (0.2, 0.1), (2, 11)
"""Of the way to the next corner: the first finds a corner that a wide lens has bent away from where its marker tells it, the
second is straight enough within."""
_SEARCHED_PX = 1000
"""Longer side of the picture in which a chessboard is searched: in 12 million pixels that takes half a minute."""
_STEPS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """(N,) numbers of the corners found (Board.corners_m) and (N, 2) where they are, `pix`; `edge_px` is how wide the edges
    between black and white are there (median), `markers` how many markers were recognised."""

    ids: NDArray[np.int64]
    pix: FloatArray
    edge_px: float = 0.0
    markers: int = 0


NOTHING = Corners(np.zeros(0, np.int64), np.zeros((0, 2)))


def detector(board: Board) -> Callable[[Image], Corners]:
    """What finds the corners of a board in a grey picture (H, W)."""
    if board.kind == "chessboard":
        return lambda grey: _of_chessboard(grey, board)
    found = cv2.aruco.CharucoDetector(board.charuco())
    return lambda grey: _of_charuco(grey, board, found)


def what_else(board: Board, pictures: list[Image]) -> str:
    """What is seen in grey pictures in which the board is not: the same mirrored, another dictionary, another layout, the other
    kind of board; empty where nothing is."""
    if board.kind == "chessboard":
        return _instead_of_chessboard(board, pictures)
    mirrored = [np.ascontiguousarray(picture[:, ::-1]) for picture in pictures]
    find = detector(board)
    if any(len(find(picture).ids) >= LEAST_CORNERS for picture in mirrored):
        return "pictures are mirrored: switch off the flip of the camera's driver"
    for name in (board.dictionary, *_FAMILIES):
        if (most := _most_markers(name, pictures)) < _LEAST_MARKERS:
            continue
        if name == board.dictionary:
            return f"{most} of its markers are seen, but not where they should be: check COLUMNSxROWS, which count squares"
        return f"{most} markers of dictionary {name} are seen, not of {board.dictionary}: name it in --board"
    return ""


def _instead_of_chessboard(board: Board, pictures: list[Image]) -> str:
    across, down = board.inner
    if min(across, down) > 3:
        fewer = replace(board, columns=board.columns - 1, rows=board.rows - 1)
        if any(len(_of_chessboard(picture, fewer).ids) for picture in pictures):
            return f"{across - 1}x{down - 1} inner corners are seen, of {across}x{down} squares: name --board {fewer.name}"
    for name in _FAMILIES:
        if (most := _most_markers(name, pictures)) >= _LEAST_MARKERS:
            return f"{most} markers of dictionary {name} are seen: name the ChArUco board that they are of in --board"
    return ""


def _most_markers(dictionary: str, pictures: list[Image]) -> int:
    markers = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}")))
    return max((_count(markers.detectMarkers(picture)[1]) for picture in pictures), default=0)


def _count(ids: NDArray[Any] | None) -> int:
    return 0 if ids is None else len(ids)


def _of_charuco(grey: Image, board: Board, found: cv2.aruco.CharucoDetector) -> Corners:
    pix, ids, _, marker_ids = found.detectBoard(grey)
    markers = _count(marker_ids)
    if pix is None or ids is None or len(ids) == 0:
        return Corners(NOTHING.ids, NOTHING.pix, 0.0, markers)
    order = np.argsort(ids.ravel())
    at = np.asarray(pix, dtype=np.float64).reshape(-1, 2)[order]
    return _refined(grey, board, ids.ravel()[order].astype(np.int64), at, markers)


def _of_chessboard(grey: Image, board: Board) -> Corners:
    factor = min(1.0, _SEARCHED_PX / max(grey.shape))
    small = grey if factor == 1.0 else cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    ok, pix = cv2.findChessboardCornersSB(small, board.inner)
    if not ok:
        return NOTHING
    across, down = grey.shape[1] / small.shape[1], grey.shape[0] / small.shape[0]
    at = (np.asarray(pix, dtype=np.float64).reshape(-1, 2) + 0.5) * (across, down) - 0.5
    return _refined(grey, board, np.arange(len(at), dtype=np.int64), at, 0)


def _refined(grey: Image, board: Board, ids: NDArray[np.int64], pix: FloatArray, markers: int) -> Corners:
    """Corners to a fraction of a pixel, each in a window that holds no other corner nor a marker's."""
    at = np.array(pix, dtype=np.float64)
    spacing = spacing_px(board, ids, at)
    for share in _WINDOW_SHARES:
        half = np.clip(np.round(share * spacing), *_WINDOW_PX).astype(int)
        for size in np.unique(half):
            here = np.ascontiguousarray(at[half == size], dtype=np.float32).reshape(-1, 1, 2)
            at[half == size] = cv2.cornerSubPix(grey, here, (int(size), int(size)), (-1, -1), _STEPS).reshape(-1, 2)
    return Corners(ids, at, edge_width_px(grey, at, spacing), markers)


def spacing_px(board: Board, ids: NDArray[np.int64], pix: FloatArray) -> FloatArray:
    """(N,) pixels from each corner to the nearest beside it on the board; their median where none beside it is seen."""
    across, down = board.inner
    grid = np.full((down + 2, across + 2, 2), np.nan)
    row, column = ids // across + 1, ids % across + 1
    grid[row, column] = pix
    beside = np.stack([grid[row + dv, column + du] for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0))])
    away = np.hypot(*np.moveaxis(beside - pix, 2, 0))
    nearest = np.where(np.isnan(away), np.inf, away).min(axis=0, initial=np.inf)
    known = np.isfinite(nearest)
    return np.where(known, nearest, np.median(nearest[known]) if known.any() else 10.0)


def edge_width_px(grey: Image, pix: FloatArray, spacing: FloatArray) -> float:
    """How many pixels edges between black and white take, median over the corners: the contrast about a corner over the
    steepest slope there."""
    widths = []
    for (u, v), away in zip(pix, spacing, strict=True):
        half = int(np.clip(0.4 * away, 3, 24))
        top, left = max(0, round(v) - half), max(0, round(u) - half)
        patch = grey[top : round(v) + half + 1, left : round(u) + half + 1].astype(np.float64)
        if min(patch.shape) < 4:
            continue
        dv, du = np.gradient(patch)
        low, high = np.percentile(patch, [5, 95])
        widths.append((high - low) / max(float(np.percentile(np.hypot(du, dv), 99)), 1e-6))
    return float(np.median(widths)) if widths else 0.0
