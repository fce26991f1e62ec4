"""Cells of ground over which soundings are taken together: thousands of them cost no more than their cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.terrain.correlation import alike
from visloc_companion.types import FloatArray

SMALLEST_M, MOST_CELLS = 10.0, 600
WIDE_M, MOST_WIDE_CELLS = 40.0, 1600
"""Over wide ground there are more: of cells wider than this the means tell less of the ground's slopes."""
NEAR_M = 100.0
"""1-sigma of the distance over which what stands on the ground is alike (standing.py)."""


@dataclass(frozen=True, eq=False)
class Cells:
    """The cell `of` each sounding (N,), and the mean place of each cell's soundings `at_m` (M, 2)."""

    of: NDArray[np.int64]
    at_m: FloatArray

    @cached_property
    def alike(self) -> FloatArray:
        """(M, M) correlation of the model's errors."""
        return alike(self.at_m)

    @cached_property
    def near(self) -> FloatArray:
        """(M, M) how much each cell says of what stands on another."""
        squared = np.square(self.at_m[:, None] - self.at_m[None]).sum(-1)
        return np.asarray(np.exp(-squared / (2 * NEAR_M**2)), dtype=np.float64)

    def sums(self, values: FloatArray) -> FloatArray:
        """(M,) or (M, K) sums over the soundings of each cell, of (N,) or (N, K)."""
        n = len(self.at_m)
        if values.ndim == 1:
            return np.asarray(np.bincount(self.of, values, n), dtype=np.float64)
        return np.column_stack([np.bincount(self.of, column, n) for column in values.T])


def cells_of(ne_m: FloatArray) -> Cells:
    """Of (N, 2) places, N > 0: cells of 10 m, or as much larger as leaves MOST_CELLS, from WIDE_M on MOST_WIDE_CELLS."""
    side = SMALLEST_M
    while True:
        _, of = np.unique(np.floor(ne_m / side).astype(np.int64), axis=0, return_inverse=True)
        of = of.ravel()
        n = int(of.max()) + 1
        most = MOST_CELLS if side < WIDE_M else MOST_WIDE_CELLS
        if n <= most:
            count = np.bincount(of, minlength=n)
            at = np.column_stack([np.bincount(of, ne_m[:, k], n) / count for k in (0, 1)])
            return Cells(of, at)
        wider = side * max(1.05, math.sqrt(n / most))
        side = min(wider, WIDE_M) if side < WIDE_M else wider
