"""Soundings thinned to the lowest of each cell: where crowns have gaps, the lowest return is the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.terrain.base import Soundings
from visloc_companion.types import FloatArray

LOW_SHARE = 0.1
"""Rank of the point taken in its cell: the very lowest is the outlier of a noisy sensor."""
MOST_POINTS = 4000


def lowest(soundings: Soundings, cell_m: float, most: int = MOST_POINTS) -> Soundings:
    """One point of each cell, with its own place (so that slopes do not lower it); larger cells where there are too many."""
    while True:
        chosen = lowest_in_cells(soundings.points_m, cell_m)
        if len(chosen) <= most:
            return soundings.picked(chosen)
        cell_m *= max(1.1, float(np.sqrt(len(chosen) / most)))


def lowest_in_cells(points_m: FloatArray, cell_m: float) -> NDArray[np.int64]:
    """(M,) indices of the low point of each cell of (N, 3) points, N > 0."""
    cells = np.floor(points_m[:, :2] / cell_m).astype(np.int64)
    cells -= cells.min(0)
    key = cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1]
    order = np.lexsort((points_m[:, 2], key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=len(order))
    return np.asarray(order[first + np.floor(LOW_SHARE * count).astype(np.int64)], dtype=np.int64)
