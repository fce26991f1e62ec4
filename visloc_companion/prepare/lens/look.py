"""Which of the pictures are of use, and why the others are not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.errors import CameraError
from visloc_companion.prepare.lens.board import Board
from visloc_companion.prepare.lens.detect import LEAST_CORNERS, detector, what_else
from visloc_companion.prepare.lens.pictures import Picture
from visloc_companion.prepare.lens.view import View
from visloc_companion.types import FloatArray, Image

CELLS = (8, 6)
"""Across and down: the picture's parts in which corners are counted."""
BLURRED, BLURRED_PX = 2.5, 4.0
"""Edges that are so many times as wide as in most of the pictures, and wider than that."""
SAME_SHARE = 0.01
"""Of the picture's width: a board that moved by less says nothing new, and what errs in both errs alike."""
_LIT, _KEPT = 12, 3


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """Views that are of use, all of one size (width, height), the names of the other pictures with the reason, and the brightest
    grey that each of CELLS (down, across) had."""

    views: list[View]
    size_px: tuple[int, int]
    left_out: dict[str, str]
    brightest: FloatArray

    @property
    def lit(self) -> np.ndarray:
        """Which of the cells the lens shows anything in: what a wide lens leaves black can hold no corner."""
        return np.asarray(self.brightest > _LIT)


def look_at(pictures: Iterable[Picture], board: Board) -> Looked:
    """Find the board in each picture. Raises CameraError where it is in none, saying what else is seen."""
    find, views, sizes = detector(board), [], []
    left_out: dict[str, str] = {}
    brightest: dict[tuple[int, int], FloatArray] = {}
    without: list[Image] = []
    for picture in pictures:
        if picture.grey is None:
            left_out[picture.name] = "cannot be read as a picture"
            continue
        size = (picture.grey.shape[1], picture.grey.shape[0])
        here = cv2.resize(picture.grey, CELLS, interpolation=cv2.INTER_AREA).astype(np.float64)
        brightest[size] = np.maximum(brightest.get(size, here), here)
        found = find(picture.grey)
        if len(found.ids) < LEAST_CORNERS:
            some = f"only {len(found.ids)} corners of the board are seen" if len(found.ids) else "no board is seen"
            left_out[picture.name] = f"{some}, {LEAST_CORNERS} are needed" if len(found.ids) else some
            without = [*without, picture.grey][:_KEPT]
            continue
        views.append(View(picture.name, found.ids, board.corners_m[found.ids], found.pix, found.edge_px))
        sizes.append(size)
    if not views:
        raise _nothing(board, left_out, without)
    counted = Counter(sizes)
    most = max(counted, key=lambda size: counted[size])
    others = {view.name: size for view, size in zip(views, sizes, strict=True) if size != most}
    left_out |= {name: f"is {w} x {h} px, most are {most[0]} x {most[1]}" for name, (w, h) in others.items()}
    kept = _sharp([view for view in views if view.name not in others], left_out)
    return Looked(_apart(kept, SAME_SHARE * most[0], left_out), most, left_out, brightest[most])


def _nothing(board: Board, left_out: dict[str, str], without: list[Image]) -> CameraError:
    if not without:
        name = next(iter(left_out), "")
        return CameraError(left_out.get(name, "no picture"), where=name, remedy="name pictures of the board, e.g. PNG or JPEG")
    seen = what_else(board, without)
    remedy = seen or f"check --board {board.name} against the sheet; all of it must be flat, lit evenly and sharp"
    return CameraError(f"the board is seen in none of {len(left_out)} pictures", where=next(iter(left_out)), remedy=remedy)


def _sharp(views: list[View], left_out: dict[str, str]) -> list[View]:
    usual = float(np.median([view.edge_px for view in views]))
    blurred = {view.name: view for view in views if view.edge_px > max(BLURRED * usual, BLURRED_PX)}
    left_out |= {name: f"is blurred: edges are {view.edge_px:.1f} px wide, {usual:.1f} in most" for name, view in blurred.items()}
    return [view for view in views if view.name not in blurred]


def _apart(views: list[View], least_px: float, left_out: dict[str, str]) -> list[View]:
    kept: list[View] = []
    for view in views:
        same = next((other for other in kept if _moved_px(view, other) < least_px), None)
        if same is None:
            kept.append(view)
        else:
            left_out[view.name] = f"is the same view as {same.name}"
    return kept


def _moved_px(one: View, other: View) -> float:
    _, here, there = np.intersect1d(one.ids, other.ids, assume_unique=True, return_indices=True)
    if len(here) < LEAST_CORNERS:
        return np.inf
    return float(np.sqrt(np.mean(np.sum(np.square(one.pix[here] - other.pix[there]), axis=1))))
