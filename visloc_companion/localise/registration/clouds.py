"""Clouds as arrays: what every method checks and leaves out before it begins, and how dense a cloud is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.registration.sampling import distinct
from visloc_companion.types import FloatArray

FEWEST_POINTS = 50
"""Fewer points have no shape."""
UP = 2
DENSITY_CELL_M = 4.0
"""A 4 m cell with a point in it counts as covered."""
SPREAD = 4
"""Cells a point up to which they are counted in an array of all cells, of about the memory of the points: faster than sorting."""
EMPTY_M, FEW_SHARE = 100.0, 0.02
"""Points that so much emptiness parts from the others, along an axis, and that are less than this share of all, are no surface
(values for no data, echoes of birds and clouds, spikes): below a cliff or a tower there are other points, or many."""
NEVER_M = 500.0
"""So much emptiness no surface has above it or below it, however many the points are: a raster's holes may be any share."""
BIN_M, MOST_BINS = 10.0, 2000
"""Emptiness is counted in whole bins; what is farther out than all of them lies in the last one."""


def checked(points_m: FloatArray, name: str) -> FloatArray:
    """The points as (N, 3) float64. Raises ValueError for another shape or values that are not finite."""
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"{name}: points are (N, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name}: {int((~np.isfinite(points)).any(1).sum())} of {len(points)} points are not finite")
    return points


def density_per_m2(points_m: FloatArray) -> float:
    """Points per square metre of the ground that they cover; what a file has twice counts once."""
    cells = np.floor(points_m[:, :2] / DENSITY_CELL_M).astype(np.int64)
    cells -= cells.min(0)
    rows, cols = (int(n) + 1 for n in cells.max(0))
    index = cells[:, 0] * cols + cells[:, 1]
    covered = np.count_nonzero(np.bincount(index)) if rows * cols <= SPREAD * len(index) else len(np.unique(index))
    return distinct(points_m) / (covered * DENSITY_CELL_M**2)


def middle_m(points_m: FloatArray) -> FloatArray:
    """(3,) The source's middle: the centre of its horizontal box at its mean height. Outliers in height hardly move it."""
    low, high = points_m[:, :2].min(0), points_m[:, :2].max(0)
    return np.array([*(low + high) / 2, float(points_m[:, 2].mean())])


def within(points_m: FloatArray, low_m: FloatArray, high_m: FloatArray, margin_share: float = 0.0) -> FloatArray:
    """The points in a horizontal box, widened on each side by a share of it."""
    margin = margin_share * (high_m - low_m) if margin_share else 0.0  # a box without bounds has no width
    inside = ((points_m[:, :2] >= low_m - margin) & (points_m[:, :2] <= high_m + margin)).all(1)
    return points_m if inside.all() else points_m[inside]


def without_strays(points_m: FloatArray, axes: Sequence[int] = (0, 1, UP)) -> FloatArray:
    """The points (N, 3) but those that emptiness parts from the others along one of the axes (0 east, 1 north, 2 up).

    From the largest group outwards: a group farther off than EMPTY_M goes where it is less than FEW_SHARE of all, and along the
    vertical whatever is farther off than NEVER_M.
    """
    for axis in axes:
        keep = _together(points_m[:, axis], NEVER_M if axis == UP else np.inf)
        points_m = points_m if keep is None else points_m[keep]
    return points_m


def _together(along_m: FloatArray, never_m: float) -> NDArray[np.bool_] | None:
    """(N,) which values to keep; None for all."""
    if not len(along_m) or float(np.ptp(along_m)) <= EMPTY_M:
        return None
    index = np.clip(np.floor((along_m - np.median(along_m)) / BIN_M), -MOST_BINS, MOST_BINS).astype(np.int64) + MOST_BINS
    count = np.bincount(index)
    held = np.flatnonzero(count)
    groups = np.split(held, np.flatnonzero((np.diff(held) - 1) * BIN_M >= EMPTY_M) + 1)
    most = int(np.argmax([count[group].sum() for group in groups]))
    keep = np.zeros(len(count), np.bool_)
    keep[groups[most]] = True
    for outwards in (groups[most::-1], groups[most:]):
        near = outwards[0]
        for group in outwards[1:]:
            empty_m = BIN_M * (int(np.abs(group - near[:, None]).min()) - 1)
            if empty_m < never_m and count[group].sum() >= FEW_SHARE * len(along_m):
                keep[group] = True
                near = group
    return None if keep[held].all() else np.asarray(keep[index])
