"""Where surface models of one place differ: another vertical datum or unit makes a step in the map where one ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from visloc_companion.geo.raster import compose_affine
from visloc_companion.prepare.heights import APART_M
from visloc_companion.prepare.mosaic import resampled
from visloc_companion.prepare.target import Source, TargetGrid
from visloc_companion.types import FloatArray

SIDE_PX, LEAST_PLACES = 512, 20
"""Heights are compared at so many places on a side of the map's surface at most, and where so many have both."""
LEAST_STEPS, GAP_PX, BASE_PX = 50, 2, 4
"""Tiles that only touch are compared at so many places over their border (crowns scatter), over such a gap at most; the slope of
the ground is that of so many places on either side."""


def seams(sources: Sequence[Source], grid: TargetGrid, kind: str) -> list[str]:
    """A sentence on each surface model (their `kind` in words) that lies more than 5 m (median) beside those before it:
    where both have heights or, if that is hardly anywhere, along their border.

    Raises MapError for damaged pixels.
    """
    if len(sources) < 2:
        return []
    cols, rows = min(grid.cols, SIDE_PX), min(grid.rows, SIDE_PX)
    T_grid_pix = np.array(
        [[grid.cols / cols, 0.0, grid.cols / cols / 2 - 0.5], [0.0, grid.rows / rows, grid.rows / rows / 2 - 0.5]]
    )
    T_map_pix = compose_affine(grid.T_map_pix, T_grid_pix)
    found: list[str] = []
    above_m = np.full((rows, cols), np.nan)
    for source in sources:
        values, known = resampled(source, grid, T_map_pix, (cols, rows))
        heights_m = np.where(known, values, np.nan)
        apart, where = (heights_m - above_m)[np.isfinite(heights_m) & np.isfinite(above_m)], "where both have heights"
        least = LEAST_PLACES
        if apart.size < least:
            apart, where = _steps(above_m, np.where(np.isfinite(above_m), np.nan, heights_m)), "along their border"
            least = LEAST_STEPS
        if apart.size >= least and abs(median_m := float(np.median(apart))) > APART_M:
            side = "above" if median_m > 0 else "below"
            found.append(
                f"{source.name} lies {abs(median_m):.1f} m {side} the {kind} before it, {where}: another "
                "vertical datum or unit, or a model of the bare ground; where one ends, the map has a step: convert one of them"
            )
        above_m = np.where(np.isfinite(above_m), above_m, heights_m)
    return found


def _steps(before_m: FloatArray, beside_m: FloatArray) -> FloatArray:
    """(N,) steps from heights to those beside them, (rows, cols) and NaN where the other has some, less what the slope makes."""
    steps = []
    for a, b in ((before_m, beside_m), (before_m.T, beside_m.T)):
        for sign in (1, -1):
            steps += [_steps_right(a[:, ::sign], b[:, ::sign], gap) for gap in range(1, GAP_PX + 1)]
    found = np.concatenate([step.ravel() for step in steps])
    return np.asarray(found[np.isfinite(found)])


def _steps_right(before_m: FloatArray, beside_m: FloatArray, gap: int) -> FloatArray:
    """Steps from a column to the one `gap` to the right of it."""
    n = max(0, before_m.shape[1] - 2 * BASE_PX - gap)

    def column(heights_m: FloatArray, first: int) -> FloatArray:
        return heights_m[:, first : first + n]

    here, there = column(before_m, BASE_PX), column(beside_m, BASE_PX + gap)
    slope = (here - column(before_m, 0) + column(beside_m, 2 * BASE_PX + gap) - there) / (2 * BASE_PX)
    return np.asarray(there - here - gap * slope)
