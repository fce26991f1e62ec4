"""Where surface models of one place differ: another vertical datum or unit makes a step in the map where one ends."""

from __future__ import annotations

import math
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
STEP_M, ALIKE = 1.0, 0.5
"""Less than 5 m is told from here on, where the models differ by nearly the same everywhere (half of the differences lie within
such a share of their median of it): no crowns or crops do, ..."""
STEP_SIGMAS, SIGMA_OF_MEDIAN = 6.0, 1.4826 * math.sqrt(math.pi / 2)
"""... and along a border, where heights beside each other scatter more, from so many standard errors on. That of a median, of
normal errors, is so many times half of the quartiles' distance over the square root of their number."""


def seams(sources: Sequence[Source], grid: TargetGrid, kind: str) -> list[str]:
    """A sentence on each surface model (their `kind` in words) that lies more than 5 m (median) beside those before it, or more
    than STEP_M by nearly the same everywhere: where both have heights or, if that is hardly anywhere, along their border.

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
        touch = apart.size < LEAST_PLACES
        if touch:
            apart, where = _steps(above_m, np.where(np.isfinite(above_m), np.nan, heights_m)), "along their border"
        if (off_m := _off(apart, touch)) is not None:
            side = "above" if off_m > 0 else "below"
            found.append(f"{source.name} lies {abs(off_m):.1f} m {side} the {kind} before it, {where}: {_why(off_m)}")
        above_m = np.where(np.isfinite(above_m), above_m, heights_m)
    return found


def _off(apart_m: FloatArray, touch: bool) -> float | None:
    """Median of differences (N,), taken along a border where models only `touch`; None where it is nothing to speak of."""
    if apart_m.size < (LEAST_STEPS if touch else LEAST_PLACES):
        return None
    median_m = float(np.median(apart_m))
    spread_m = float(np.median(np.abs(apart_m - median_m)))
    least_m = max(STEP_M, STEP_SIGMAS * SIGMA_OF_MEDIAN * spread_m / math.sqrt(apart_m.size) if touch else spread_m / ALIKE)
    return median_m if abs(median_m) > min(APART_M, least_m) else None


def _why(off_m: float) -> str:
    """What a model that lies so far off may be, and what to do."""
    if abs(off_m) > APART_M:
        return (
            "another vertical datum or unit, or a model of the bare ground; "
            "where one ends, the map has a step: convert one of them"
        )
    return (
        "another vertical datum or date; where one ends, the map has a step, and fixes beside it are off by about as much: "
        f"raise or lower one of them (gdal_calc.py -A FILE --calc=A{-off_m:+.1f} --outfile NEW.tif)"
    )


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
