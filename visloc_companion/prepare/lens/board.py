"""The boards that are photographed: what they are called, and where on them their corners lie."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np

from visloc_companion.errors import ConfigError, did_you_mean
from visloc_companion.prepare.defaults import DEFAULT_BOARD
from visloc_companion.types import FloatArray

WAYS = "charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] (squares) or chessboard:COLUMNSxROWS:SQUARE (inner corners)"
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)(mm|cm|m)")
_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_FAMILY, _SIZES = "4X4", (50, 100, 250, 1000)
_LEAST, _MOST = 3, 60


@dataclass(frozen=True)
class Board:
    """`columns` and `rows` count squares, of `square_m` metres; `marker_m` and `dictionary` (OpenCV's name without DICT_) are
    those of a ChArUco board. Corners are counted along the rows, from 0, in the board's metres: right, down, and 0 out of it."""

    kind: Literal["charuco", "chessboard"]
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""

    @property
    def name(self) -> str:
        """As it is named on the command line."""
        square = f"{1e3 * self.square_m:g}mm"
        if self.kind == "chessboard":
            return f"chessboard:{self.columns - 1}x{self.rows - 1}:{square}"
        return f"charuco:{self.columns}x{self.rows}:{square}:{1e3 * self.marker_m:g}mm:{self.dictionary}"

    @property
    def inner(self) -> tuple[int, int]:
        """Inner corners along a row, and rows of them."""
        return self.columns - 1, self.rows - 1

    @cached_property
    def corners_m(self) -> FloatArray:
        """(N, 3) of every corner between four squares."""
        across, down = self.inner
        v, u = np.mgrid[1 : down + 1, 1 : across + 1].reshape(2, -1)
        return np.column_stack([u * self.square_m, v * self.square_m, np.zeros(len(u))])

    def charuco(self, dictionary: str = "") -> cv2.aruco.CharucoBoard:
        """OpenCV's own; in another dictionary where one is named."""
        number = getattr(cv2.aruco, f"DICT_{dictionary or self.dictionary}")
        pattern = cv2.aruco.getPredefinedDictionary(number)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, pattern)


def parse_board(text: str) -> Board:
    """A board by its name. Raises ConfigError naming what is wrong, and the two ways to say it."""
    parts = text.strip().split(":")
    ways: dict[str, Callable[[list[str]], Board]] = {"charuco": _charuco, "chessboard": _chessboard}
    try:
        if parts[0] not in ways:
            raise ValueError(f"{parts[0]!r} is no kind of board {did_you_mean(parts[0], ways)}".rstrip())
        return ways[parts[0]](parts[1:])
    except ValueError as why:
        raise ConfigError(f"{text!r}: {why}", where="--board", remedy=f"write {WAYS}, e.g. {DEFAULT_BOARD}") from why


def _chessboard(parts: list[str]) -> Board:
    if len(parts) != 2:
        raise ValueError("a chessboard has inner corners and the size of a square")
    across, down = _counts(parts[0])
    return Board("chessboard", across + 1, down + 1, _length_m(parts[1]))


def _charuco(parts: list[str]) -> Board:
    if len(parts) not in (3, 4):
        raise ValueError("a ChArUco board has squares, the size of a square, that of a marker, and maybe a dictionary")
    columns, rows = _counts(parts[0])
    square_m, marker_m = _length_m(parts[1]), _length_m(parts[2])
    if not 0.3 * square_m <= marker_m < 0.95 * square_m:
        raise ValueError(f"markers of {parts[2]} in squares of {parts[1]}: they take 30 to 95 % of a square's side")
    needed = columns * rows // 2
    named = parts[3].upper().removeprefix("DICT_") if len(parts) == 4 else _smallest(needed)
    known = [name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")]
    match = next((name for name in known if name.upper() == named), None)
    if match is None:
        raise ValueError(f"there is no dictionary {named} {did_you_mean(named, known)}".rstrip())
    board = Board("charuco", columns, rows, square_m, marker_m, match)
    held = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{match}")).bytesList)
    if needed > held:
        raise ValueError(f"{columns}x{rows} squares need {needed} markers, {match} has {held}")
    return board


def _smallest(needed: int) -> str:
    size = next((size for size in _SIZES if size >= needed), _SIZES[-1])
    return f"{_FAMILY}_{size}"


def _counts(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,3})[xX](\d{1,3})", text)
    if found is None:
        raise ValueError(f"{text!r} is not COLUMNSxROWS")
    columns, rows = int(found[1]), int(found[2])
    if not (_LEAST <= columns <= _MOST and _LEAST <= rows <= _MOST):
        raise ValueError(f"{text}: {_LEAST} to {_MOST} of each can be used")
    return columns, rows


def _length_m(text: str) -> float:
    found = _LENGTH.fullmatch(text)
    if found is None or float(found[1]) <= 0:
        raise ValueError(f"{text!r} is no length in mm, cm or m")
    return float(found[1]) * _UNITS_M[found[2]]
