"""What stands for "unknown" in rasters that do not say so: values that are no height or colour, and tiles never written.

GDAL reads a missing tile of a sparse file as zeros, and a hole of a surface model that is zero is a pit as deep as the ground is
high: neither looks wrong to whoever reads the file alone.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

NO_COLOURS = (-9999.0, -32767.0, -32768.0, float(np.finfo(np.float32).min))
"""What programs write into bands of signed or real numbers where they have nothing."""
HEIGHTS_M = (-1000.0, 10_000.0)
"""Nothing on land is lower or higher: what a surface model holds beyond stands for "unknown", whether or not the file says so."""
LEAST_PX, LEAST_SHARE = 16, 1e-4
"""A value that fewer pixels have, or a smaller share of them, may be anything."""
BELOW_M, ABOVE_M, HIGH_M = 30.0, 1000.0, 5000.0
"""A fill lies at or below 0 m and so far below all heights, or above the last and so far above them ..."""
BETWEEN_SHARE, RIM_PX = 0.01, 4
"""... with at most such a share of its own pixels in between: ground and sea have slopes there. Pixels so near to a fill are not
counted, for resampling has mixed it into them."""
FILL_SHARE = 0.01
"""A value above all land that such a share of the pixels has is one that stands for "unknown"."""
SAME_M, OVERSHOT = 1e-3, 0.2
"""Kernels keep a fill to so much, and cubic ones make more of the step beside it than it is, by no such share of it."""


def undeclared_fill(heights_m: NDArray[Any], used: NDArray[np.bool_], rim: int) -> float | None:
    """The height, of a sample (rows, cols) where it is `used`, that is none: the same in many pixels, and far from all others but
    those up to `rim` samples beside it; None where there is none."""
    known = heights_m[used]
    low, middle, high = float(known.min()), float(np.median(known)), float(known.max())
    lowest = known[known <= low + OVERSHOT * (middle - low)]
    highest = known[known >= high - OVERSHOT * (high - middle)]
    for fill, gap_m in ((_commonest(lowest), BELOW_M), (_commonest(highest), ABOVE_M)):
        if 0 < fill < HIGH_M:
            continue
        filled = used & (np.abs(heights_m - fill) <= SAME_M)
        beside = cv2.dilate(filled.astype(np.uint8), np.ones((2 * rim + 1,) * 2, np.uint8)) > 0
        n_fill = int(filled.sum())
        n_near = int((used & ~beside & (np.abs(heights_m - fill) <= gap_m)).sum())
        if max(LEAST_PX, LEAST_SHARE * known.size) <= n_fill < known.size and n_near <= BETWEEN_SHARE * n_fill:
            return fill
    return None


def no_metres(heights_m: NDArray[Any], counts: NDArray[Any]) -> tuple[str, str] | None:
    """What is wrong, and the remedy, where most of a surface model's heights, each (N,) once and how many pixels have it, lie
    above all land: they are in another unit. Single values that many pixels have stand for "unknown" and are left out; below
    all land lies the floor of the sea."""
    too_high = heights_m > HEIGHTS_M[1]
    spread = ~too_high | (counts < FILL_SHARE * counts.sum())
    if not counts[too_high & spread].sum() > counts[spread].sum() / 2:
        return None
    middle = float(np.median(np.repeat(heights_m[spread], counts[spread])))
    return (
        f"its heights would be {middle:.0f} m in the median, as no land's are: they are in another unit",
        "state it: gdal_edit.py -scale 0.01 FILE for centimetres (0.1 for decimetres, 0.001 for millimetres)",
    )


def _commonest(heights_m: NDArray[Any]) -> float:
    values, counts = np.unique(heights_m, return_counts=True)
    return float(values[np.argmax(counts)])


def no_colour(raw: NDArray[Any]) -> NDArray[np.bool_]:
    """(rows, cols) where all bands of (bands, rows, cols) hold one value that stands for nothing."""
    empty = np.zeros(raw.shape[1:], np.bool_)
    if np.issubdtype(raw.dtype, np.unsignedinteger):
        return empty
    for value in NO_COLOURS:
        empty |= (raw == value).all(axis=0)
    return empty


def missing_blocks(dataset: Any) -> NDArray[np.bool_] | None:
    """(block rows, block columns) of an open GeoTIFF that were never written; None where none is missing, or nobody can tell."""
    if dataset.driver != "GTiff":
        return None
    height, width = dataset.block_shapes[0]
    shape = -(-dataset.height // height), -(-dataset.width // width)
    absent = np.array([[_offset(dataset, row, col) is None for col in range(shape[1])] for row in range(shape[0])], np.bool_)
    return absent if absent.any() and not absent.all() else None


def in_missing(dataset: Any, missing: NDArray[np.bool_], rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(rows, cols) whether the pixels of these rows (N,) and columns (M,) lie in blocks that are missing."""
    height, width = dataset.block_shapes[0]
    return np.asarray(missing[np.ix_(rows // height, cols // width)], dtype=np.bool_)


def _offset(dataset: Any, row: int, col: int) -> str | None:
    """Where a block lies in the file."""
    found: str | None = dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=1)
    return found
