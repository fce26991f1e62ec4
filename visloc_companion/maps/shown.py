"""Where a raster says that it shows something: by a mask, an alpha band, a nodata value, or by both of the last two.

rasterio's `dataset_mask` takes the fourth band's mask for all where the first band is red, and else that of any band: with a
nodata value, alpha then shows what it hides, infrared of zero is a hole, and so is none where a second band has a value.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.errors import NodataShadowWarning
from rasterio.windows import Window

SHADES, LEAST_SHADES = 0.25, 16
"""An alpha band with such a share of pixels that are neither empty nor full, and so many shades, is a colour: near infrared,
marked as alpha because GDAL takes the last of four bands for that unless it is told otherwise."""
SAMPLE_PX = 512
HALF = 127


@dataclass(frozen=True, slots=True)
class Shown:
    """What says where a raster shows something: GDAL's masks of `bands`, any of them, and the band `alpha` besides (0: none).

    Without bands the file does not say it. `is_alpha`: the masks are those of alpha alone.
    """

    bands: tuple[int, ...]
    alpha: int = 0
    is_alpha: bool = False

    @property
    def is_stated(self) -> bool:
        """Whether the file says where it is empty."""
        return bool(self.bands)

    def tells(self, shown: NDArray[np.bool_]) -> bool:
        """Whether the file says where it is empty, `shown` being (rows, cols) where it shows something: alpha that hides nothing
        says nothing (tiles of JPEG have no other, nor has a map view that is saved with its background)."""
        return self.is_stated and not (self.is_alpha and bool(shown.all()))

    def read(self, dataset: Any, shape: tuple[int, int], window: Window | None = None) -> NDArray[np.bool_]:
        """(rows, cols) where the dataset says that it shows something, in a window or all of it; all where it says nothing.

        Raises rasterio's errors for damaged pixels.
        """
        if not self.bands:
            return np.ones(shape, np.bool_)
        how = {"window": window, "resampling": Resampling.nearest}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NodataShadowWarning)  # what it warns of is done below
            masks = dataset.read_masks(list(self.bands), out_shape=(len(self.bands), *shape), **how)
        shown = masks.max(axis=0) > _opaque(dataset)
        if self.alpha:
            shown &= dataset.read(self.alpha, out_shape=shape, **how) > _opaque(dataset)
        return np.asarray(shown, dtype=np.bool_)


def shown_by(dataset: Any, meanings: tuple[ColorInterp, ...]) -> Shown:
    """What says where an open raster of colours shows something. Raises rasterio's errors for damaged pixels."""
    if MaskFlags.nodata in dataset.mask_flag_enums[0]:
        alpha = _alpha(dataset, meanings)
        return Shown(tuple(band for band in dataset.indexes if band != alpha), alpha)
    marked = MaskFlags.alpha in dataset.mask_flag_enums[0]
    return Shown(()) if marked and dataset.dtypes[0] == "uint8" and not _alpha(dataset, meanings) else _by_mask(dataset)


def heights_shown_by(dataset: Any, meanings: tuple[ColorInterp, ...]) -> Shown:
    """The same of a surface model, whose first band alone, and alpha, count."""
    declared = MaskFlags.nodata in dataset.mask_flag_enums[0]
    return Shown((1,), _alpha(dataset, meanings)) if declared else _by_mask(dataset)


def thinned(dataset: Any) -> tuple[int, int]:
    """Shape of a read that tells enough of a raster's values."""
    return min(SAMPLE_PX, dataset.height), min(SAMPLE_PX, dataset.width)


def _by_mask(dataset: Any) -> Shown:
    flags = dataset.mask_flag_enums[0]
    return Shown(() if MaskFlags.all_valid in flags else (1,), is_alpha=MaskFlags.alpha in flags)


def _alpha(dataset: Any, meanings: tuple[ColorInterp, ...]) -> int:
    """The band that is alpha, 0 where none is: one of many shades is a colour."""
    if ColorInterp.alpha not in meanings:
        return 0
    alpha = meanings.index(ColorInterp.alpha) + 1
    band = dataset.read(alpha, out_shape=thinned(dataset))
    shaded = len(np.unique(band)) >= LEAST_SHADES and float(((band > 0) & (band < band.max())).mean()) >= SHADES
    return 0 if shaded else alpha


def _opaque(dataset: Any) -> int:
    """More than this shows something: GDAL scales a wider alpha, whatever its largest value is."""
    return HALF if dataset.dtypes[-1] == "uint8" else 0
