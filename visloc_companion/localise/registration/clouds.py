"""Clouds as arrays: what every method checks before it begins, and how dense a cloud is."""

from __future__ import annotations

import numpy as np

from visloc_companion.types import FloatArray

FEWEST_POINTS = 50
"""Fewer points have no shape."""
DENSITY_CELL_M = 4.0
"""A 4 m cell with a point in it counts as covered."""
SPREAD = 4
"""Cells a point up to which they are counted in an array of all cells, of about the memory of the points: faster than sorting."""


def checked(points_m: FloatArray, name: str) -> FloatArray:
    """The points as (N, 3) float64. Raises ValueError for another shape or values that are not finite."""
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"{name}: points are (N, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name}: {int((~np.isfinite(points)).any(1).sum())} of {len(points)} points are not finite")
    return points


def density_per_m2(points_m: FloatArray) -> float:
    """Points per square metre of the ground that they cover."""
    cells = np.floor(points_m[:, :2] / DENSITY_CELL_M).astype(np.int64)
    cells -= cells.min(0)
    rows, cols = (int(n) + 1 for n in cells.max(0))
    index = cells[:, 0] * cols + cells[:, 1]
    covered = np.count_nonzero(np.bincount(index)) if rows * cols <= SPREAD * len(index) else len(np.unique(index))
    return len(points_m) / (covered * DENSITY_CELL_M**2)


def middle_m(points_m: FloatArray) -> FloatArray:
    """(3,) The source's middle: the centre of its horizontal box at its mean height. Outliers in height hardly move it."""
    low, high = points_m[:, :2].min(0), points_m[:, :2].max(0)
    return np.array([*(low + high) / 2, float(points_m[:, 2].mean())])


def within(points_m: FloatArray, low_m: FloatArray, high_m: FloatArray, margin_share: float = 0.0) -> FloatArray:
    """The points in a horizontal box, widened on each side by a share of it."""
    margin = margin_share * (high_m - low_m) if margin_share else 0.0  # a box without bounds has no width
    inside = ((points_m[:, :2] >= low_m - margin) & (points_m[:, :2] <= high_m + margin)).all(1)
    return points_m if inside.all() else points_m[inside]
