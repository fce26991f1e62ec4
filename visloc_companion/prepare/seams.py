"""Where surface models of one place differ: another vertical datum or unit makes a step in the map where one ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from visloc_companion.geo.raster import compose_affine
from visloc_companion.prepare.heights import APART_M
from visloc_companion.prepare.mosaic import resampled
from visloc_companion.prepare.target import Source, TargetGrid

SIDE_PX, LEAST_PLACES = 512, 20
"""Heights are compared at so many places on a side of the map's surface at most, and where so many have both."""


def seams(sources: Sequence[Source], grid: TargetGrid) -> list[str]:
    """A sentence on each surface model that lies more than 5 m (median) beside those before it, where both have heights.

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
        apart = (heights_m - above_m)[np.isfinite(heights_m) & np.isfinite(above_m)]
        if apart.size >= LEAST_PLACES and abs(median_m := float(np.median(apart))) > APART_M:
            side = "above" if median_m > 0 else "below"
            found.append(
                f"{source.name} lies {abs(median_m):.1f} m {side} the surface models before it, where both have heights: another "
                "vertical datum or unit, or a model of the bare ground; where one ends, the map has a step: convert one of them"
            )
        above_m = np.where(np.isfinite(above_m), above_m, heights_m)
    return found
