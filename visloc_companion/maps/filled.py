"""Holes of surface models, filled from the heights about them: a resampled height needs all pixels about it, so that scattered
holes cost nine times as much ground as they are large."""

from __future__ import annotations

import numpy as np
import rasterio.fill
from numpy.typing import NDArray

from visloc_companion.maps.layer import ArrayLayer, array_layer

FILL_PX, FILL_M = 12, 30.0
"""From how far off at most a hole is filled, and from one pixel at least: slopes go on beyond that as nobody knows."""
STRIP_ROWS = 1024
"""Rows that are filled at once; more would take as much memory again as the whole raster."""
_UNKNOWN_M = -1e6


def fill_reach_px(pixel_m: float) -> int:
    """From how many pixels off holes of a raster with pixels of this size are filled; one of a coarse one."""
    return min(FILL_PX, max(1, int(FILL_M / pixel_m)))


def filled(heights_m: NDArray[np.float32], known: NDArray[np.bool_], reach_px: int) -> NDArray[np.float32]:
    """(rows, cols) heights with holes filled from what lies up to `reach_px` about them; NaN where that is nothing."""
    if known.all() or not known.any():
        return np.where(known, heights_m, np.float32(np.nan))
    out = rasterio.fill.fillnodata(np.where(known, heights_m, np.float32(_UNKNOWN_M)), known, max_search_distance=reach_px)
    return np.where(out > _UNKNOWN_M / 10, out, np.float32(np.nan)).astype(np.float32)


def fill_holes(heights_m: NDArray[np.float32], known: NDArray[np.bool_], reach_px: int) -> None:
    """As `filled`, in place: (rows, cols) of `heights_m` and of `known`."""
    above_m, above_known = heights_m[:0], known[:0]
    for top in range(0, len(known), STRIP_ROWS):
        bottom = min(len(known), top + STRIP_ROWS)
        below = slice(top, bottom + reach_px)
        strip_m, strip_known = np.concatenate([above_m, heights_m[below]]), np.concatenate([above_known, known[below]])
        first = len(above_m)
        last = slice(max(top, bottom - reach_px), bottom)
        above_m, above_known = heights_m[last].copy(), known[last].copy()
        if not known[top:bottom].all():
            found_m = filled(strip_m, strip_known, reach_px)[first : first + bottom - top]
            holes = ~known[top:bottom] & np.isfinite(found_m)
            heights_m[top:bottom][holes] = found_m[holes]
            known[top:bottom] |= holes


def without_holes(surface: ArrayLayer, pixel_m: float) -> ArrayLayer:
    """A surface model without its smaller holes, as packs have it. Its arrays are used."""
    heights_m, valid = surface.levels[0]
    if (valid > 0).all():
        return surface
    known = valid > 0
    fill_holes(heights_m, known, fill_reach_px(pixel_m))
    return array_layer(surface.T_map_pix, heights_m, known)
