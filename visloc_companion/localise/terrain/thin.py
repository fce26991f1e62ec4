"""Soundings thinned to a low one of each cell: where crowns have gaps, the lowest return is the ground.

The lowest of several is low by its own noise, too (of four by a sigma), which lifts the vehicle. So the low one only says how
high the ground is about; of those that differ from it by no more than noise does, the one that stands nearest to the cell's
middle is taken: where a sounding stands has nothing to do with its noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.terrain.base import Kind, Soundings
from visloc_companion.types import FloatArray

LOW_SHARE = 0.1
"""Rank of the low point of a cell: the very lowest is the outlier of a noisy sensor."""
NOISE_SIGMAS = 2.5
MOST_POINTS = {Kind.PATCH: 4000, Kind.PROFILE: 600}
"""Of a line no more than what whitening.py has a covariance of."""


def lowest(soundings: Soundings, cell_m: float, most: int | None = None) -> Soundings:
    """One point of each cell, with its own place (so that slopes do not lower it); larger cells where there are more than `most`
    (MOST_POINTS)."""
    most = most or MOST_POINTS[soundings.kind]
    while True:
        chosen = low_in_cells(soundings.points_m, cell_m, soundings.sigma_m)
        if len(chosen) <= most:
            return soundings.picked(chosen)
        cell_m *= max(1.1, float(np.sqrt(len(chosen) / most)))


def low_in_cells(points_m: FloatArray, cell_m: float, sigma_m: float) -> NDArray[np.int64]:
    """(M,) indices of the point of each cell of (N, 3) points with a noise of `sigma_m` that stands for its ground, N > 0."""
    at = points_m[:, :2] / cell_m
    cells = np.floor(at).astype(np.int64)
    off_middle = np.square(at - cells - 0.5).sum(1)
    cells -= cells.min(0)
    key = cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1]
    order = np.lexsort((points_m[:, 2], key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=len(order))
    low = points_m[order[first + np.floor(LOW_SHARE * count).astype(np.int64)], 2]
    above = points_m[order, 2] - np.repeat(low, count)
    apart = (above < 0) | (above > NOISE_SIGMAS * sigma_m)
    of_cell = np.repeat(np.arange(len(first)), count)
    nearest = np.lexsort((off_middle[order], apart, of_cell))
    return np.asarray(order[nearest[first]], dtype=np.int64)
