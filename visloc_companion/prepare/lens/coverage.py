"""In which parts of the picture corners of the board were seen: a lens is known there, and guessed elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.prepare.lens.look import CELLS
from visloc_companion.types import FloatArray

_ROWS, _COLUMNS = ("upper", "middle", "lower"), ("left", "middle", "right")
_CORNER = 2
"""Cells across and down that make a corner of the picture: a quarter of its width, a third of its height."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How many corners were seen in each of look.CELLS, (down, across), and which of them the lens shows anything in."""

    counts: NDArray[np.int64]
    lit: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Of the cells that show anything, those in which corners were seen."""
        return float((self.counts[self.lit] > 0).mean()) if self.lit.any() else 0.0

    @property
    def empty_corners(self) -> list[str]:
        """Corners of the picture that show something, and in which no corner of the board was seen."""
        down, across = slice(None, _CORNER), slice(-_CORNER, None)
        places = {
            (v, u): (row, column)
            for v, row in (("upper", down), ("lower", across))
            for u, column in (("left", down), ("right", across))
        }
        return [f"{v} {u}" for (v, u), at in places.items() if self.lit[at].any() and not self.counts[at].any()]

    @property
    def emptiest(self) -> list[str]:
        """Ninths of the picture of whose cells that show anything more than half hold no corner of the board."""
        found = []
        for name, part, lit in zip(_NAMES, _ninths(self.counts), _ninths(self.lit), strict=True):
            if lit.any() and (part[lit] == 0).mean() > 0.5:
                found.append(name)
        return found


def part_of(row: int, column: int) -> str:
    """The name of the ninth of the picture in which one of look.CELLS lies."""
    across, down = CELLS
    ninths = [np.array_split(np.arange(n), 3) for n in (down, across)]
    v, u = (next(k for k, part in enumerate(parts) if at in part) for parts, at in zip(ninths, (row, column), strict=True))
    return _NAMES[3 * v + u]


_NAMES = [("centre" if v == u == "middle" else f"{v} {u}") for v in _ROWS for u in _COLUMNS]


def coverage(pix: FloatArray, size_px: tuple[int, int], lit: NDArray[np.bool_]) -> Coverage:
    """Of (N, 2) corners in a picture of so many pixels across and down."""
    across, down = CELLS
    column = np.clip(((pix[:, 0] + 0.5) * across / size_px[0]).astype(int), 0, across - 1)
    row = np.clip(((pix[:, 1] + 0.5) * down / size_px[1]).astype(int), 0, down - 1)
    counts = np.zeros((down, across), np.int64)
    np.add.at(counts, (row, column), 1)
    return Coverage(counts, lit)


def _ninths(cells: NDArray[np.generic]) -> list[NDArray[np.generic]]:
    return [part for rows in np.array_split(cells, 3, axis=0) for part in np.array_split(rows, 3, axis=1)]
