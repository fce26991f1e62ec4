"""Whether a raster's overviews are averages: gdaladdo makes them of the nearest pixels unless it is told otherwise.

Such an overview shows the ground up to half of its pixel beside where it lies, and with the noise of single pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rasterio.enums import Resampling
from rasterio.windows import Window

from visloc_companion.maps.shown import Shown

SIDE_PX, PLACES = 64, 3
"""Windows of the first overview, and how many of them on a side are looked at."""
MOST_FACTOR = 16
"""A first overview that is coarser serves no level."""


def overviews_are_averages(dataset: Any, band: int, shown: Shown) -> bool:
    """False where single pixels are nearer to what the first overview holds than their mean is; True also where nothing tells.

    Raises rasterio's errors for damaged pixels.
    """
    factors = dataset.overviews(band)
    side = SIDE_PX * factors[0] if factors else 0
    if not factors or not 2 <= factors[0] <= MOST_FACTOR or min(dataset.height, dataset.width) < side:
        return True
    errors = np.zeros(1 + factors[0] ** 2)
    for row in np.linspace(0, dataset.height - side, PLACES):
        for col in np.linspace(0, dataset.width - side, PLACES):
            corner = (int(place) // factors[0] * factors[0] for place in (col, row))
            errors += _errors(dataset, band, shown, Window(*corner, side, side))
    return bool(errors[0] <= errors[1:].min())


def _errors(dataset: Any, band: int, shown: Shown, window: Window) -> Any:
    """(1 + factor²,) sums of how far the overview is off the mean of the pixels below it, and off each of them."""
    half, side = (SIDE_PX, SIDE_PX), int(window.width)
    overview = dataset.read(band, window=window, out_shape=half, resampling=Resampling.nearest).astype(np.float64)
    pixels = _blocks(dataset.read(band, window=window).astype(np.float64))
    known = _blocks(shown.read(dataset, (side, side), window)).all(axis=0) & np.isfinite(pixels).all(axis=0)
    off = np.abs(np.vstack([pixels.mean(axis=0)[None], pixels]) - overview.ravel())
    return off[:, known].sum(axis=1)


def _blocks(full: Any) -> Any:
    """(factor², SIDE_PX²) the pixels below each of the overview's."""
    factor = full.shape[0] // SIDE_PX
    return full.reshape(SIDE_PX, factor, SIDE_PX, factor).transpose(1, 3, 0, 2).reshape(factor**2, -1)
