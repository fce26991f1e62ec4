"""Points of matched pairs, and several pairs' points as one upper surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.localise.structure.disparity import Disparity
from visloc_companion.localise.structure.rectify import RectifiedPair
from visloc_companion.types import FloatArray

BAND_CELLS, BAND_SIGMA = 1.0, 3.0
"""What lies within so many cell sides plus so many sigmas below a cell's top is the same surface."""
SPREAD = 4
"""Cells a point up to which there are arrays of all cells: from high up most cells hold no point."""
LEAST_DISPARITY_PX = 1.0
"""Of the whole baseline; pairs are chosen with some fifty. What has less (waves, a picture matched to itself) is no ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """`m` (N, 3) east, north, up and `sigma_m` (N,) of the heights, from disparity alone."""

    m: FloatArray
    sigma_m: FloatArray


def triangulated(pair: RectifiedPair, disparity: Disparity) -> Points:
    """A point for each trusted pixel that is not beyond all ground; a depth Z has sigma Z² / (f B) times its disparity's."""
    row, column = np.nonzero(disparity.good & (disparity.value_px + pair.offset_px >= LEAST_DISPARITY_PX))
    depth = pair.depth_m(disparity.value_px[row, column].astype(np.float64))
    rays = pair.view.rays(np.column_stack([column, row]).astype(np.float64))
    points = rays * depth[:, None] @ pair.view.R_local_view.T + pair.T_left[:3, 3]
    sigma = depth**2 / (pair.view.focal_px * pair.baseline_m) * disparity.sigma_px[row, column]
    return Points(points, sigma)


def upper_surface(parts: Sequence[Points], cell_m: float) -> Points:
    """One point for each cell: the weighted mean of what lies near the cell's top.

    The points of one pair in a cell share their window's error, so only pairs make a height better, not their number of points.
    """
    points, sigma = np.vstack([p.m for p in parts]), np.concatenate([p.sigma_m for p in parts])
    if not len(points):
        return Points(points, sigma)
    origin = points[:, :2].min(0)
    at = ((points[:, :2] - origin) / cell_m).astype(np.int64)
    cell = at[:, 0] * (int(at[:, 1].max()) + 1) + at[:, 1]
    if int(cell.max()) >= SPREAD * len(cell):
        cell = np.unique(cell, return_inverse=True)[1]
    n = int(cell.max()) + 1
    top = np.full(n, -np.inf)
    np.maximum.at(top, cell, points[:, 2])
    near = points[:, 2] >= top[cell] - BAND_CELLS * cell_m - BAND_SIGMA * sigma
    pair = np.repeat(np.arange(len(parts)), [len(p.m) for p in parts])[near]
    points, sigma, cell = points[near], sigma[near], cell[near]
    weight = 1 / sigma**2
    total = np.bincount(cell, weight, n)
    used = np.flatnonzero(total)
    mean = np.column_stack([np.bincount(cell, weight * points[:, k], n)[used] / total[used] for k in range(3)])
    share = np.bincount(pair * n + cell, weight, len(parts) * n).reshape(len(parts), n)[:, used] / total[used]
    typical = np.bincount(cell, np.ones(len(cell)), n)[used] / total[used]
    return Points(mean, np.sqrt(typical * (share**2).sum(0)))
