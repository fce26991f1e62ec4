"""TIFFs whose grey counts from white (MINISWHITE, as scanners and old archives write them): 0 is white, the largest value black.

GDAL says so in a tag and hands out the values as they are: taken for grey they are the negative.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.maps.layer import Validity, Values


def counts_from_white(dataset: Any) -> bool:
    """Whether the values of an open raster are those of a negative."""
    return str(dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE", "")).upper() == "YES"


def as_shown(dataset: Any, values: NDArray[Any]) -> NDArray[Any]:
    """Values that were read of an open raster, in any shape: uint8 of a negative the other way round, others as they are."""
    return np.uint8(255) - values if values.dtype == np.uint8 and counts_from_white(dataset) else values


def positive(values: Values, valid: Validity) -> Values:
    """(rows, cols[, 3]) uint8 of a negative the other way round, where they are `valid`; 0 elsewhere."""
    shown = valid > 0 if values.ndim == 2 else (valid > 0)[..., np.newaxis]
    return np.where(shown, np.uint8(255) - values.astype(np.uint8), np.uint8(0))
