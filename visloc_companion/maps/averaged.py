"""Holes of a surface model that a program has taken for ground and averaged with it.

Whoever resamples a model without regard to the value that stands for its holes (-9999 or 0, say) leaves a rim of heights between
that and the ground about each: pits as any others, whatever the file declares.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from visloc_companion.maps.fills import BELOW_M, HEIGHTS_M, LEAST_PX, RIM_PX, no_metres
from visloc_companion.maps.shown import Shown
from visloc_companion.types import FloatArray

ROWS = 64
"""So many rows are looked at, pixel by pixel: GDAL thins by overviews, which may be averages where the file itself is none."""
STEEP = 2.0
"""From the first height beside a hole to that RIM_PX further on, ground hardly ever rises or falls by more than 30 m or, where
pixels are large, by this slope ..."""
RIM_SHARE = 0.25
"""... and never at such a share of the holes' edges, all to one side: towers and walls that hide the ground are few."""


def averaged_holes(dataset: Any, shown: Shown, unit_m: float, lift_m: float, gsd_m: float) -> tuple[str, str] | None:
    """What is wrong, and the remedy, where holes of an open surface model, whose heights are `unit_m` times its values and
    `lift_m`, were averaged with the ground, or hardly any of these is a height; None where they were not, or few holes are there.

    Raises rasterio's errors for damaged pixels.
    """
    raw, mask = _rows(dataset, shown)
    holes = ~mask | ~np.isfinite(raw)
    values, counts = np.unique(raw[~holes], return_counts=True)
    heights = values * unit_m + lift_m
    if (said := no_metres(heights, counts)) is not None:
        return said
    no_land = (heights < HEIGHTS_M[0]) | (heights > HEIGHTS_M[1])
    holes |= np.isin(raw, values[no_land & (counts >= LEAST_PX)])
    ends = [_ends(raw[:, ::sign], holes[:, ::sign]) for sign in (1, -1)]
    first, beyond = np.concatenate([end[0] for end in ends]), np.concatenate([end[1] for end in ends])
    gap = max(BELOW_M, STEEP * RIM_PX * gsd_m) / unit_m
    for sign, test in ((1, "A<LOWEST"), (-1, "A>HIGHEST")):
        mixed = sign * (beyond - first) > gap
        if mixed.sum() >= max(LEAST_PX, RIM_SHARE * first.size):
            return (
                f"holes were averaged with the ground when it was resampled, to {np.median(first[mixed]):.6g} for one",
                "resample the original with its holes declared (gdalwarp -srcnodata VALUE), or leave out what no ground is: "
                f"gdal_calc.py -A FILE --calc='where({test},-9999,A)' --NoDataValue=-9999 --outfile NEW.tif "
                f"(the median of its heights is {np.median(raw[~holes]):.6g})",
            )
    return None


def _ends(raw: FloatArray, holes: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """(N,) the first value behind each hole, along the rows, and that RIM_PX further on, where no other hole lies between."""
    n = raw.shape[1] - RIM_PX - 1
    if n < 1:
        return np.zeros(0), np.zeros(0)
    clear = ~np.any([holes[:, 1 + k : 1 + k + n] for k in range(RIM_PX + 1)], axis=0)
    ends = holes[:, :n] & clear
    return raw[:, 1 : 1 + n][ends], raw[:, 1 + RIM_PX : 1 + RIM_PX + n][ends]


def _rows(dataset: Any, shown: Shown) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(rows, cols) values of the first band in some rows, and where the file shows something."""
    raw, mask = [], []
    for row in np.unique(np.linspace(0, dataset.height - 1, ROWS).astype(int)).tolist():
        window = Window(0, row, dataset.width, 1)
        raw.append(dataset.read(1, window=window)[0])
        mask.append(shown.read(dataset, (1, dataset.width), window)[0])
    return np.asarray(raw, dtype=np.float64), np.asarray(mask, dtype=np.bool_)
