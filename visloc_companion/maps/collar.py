"""The fill about an orthophoto that does not say where it is empty.

A survey is no rectangle, and a turned one leaves corners: without a nodata value, a mask or alpha they are black or white as any
other pixels. Frames at such a border are compared with the fill, and its outline looks like the edge of a field.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.maps.layer import Values

LEAST_SHARE = 1e-3
"""Of the picture: smaller patches of fill at its border are dark or bright things."""
LOSSY_BLOCK_PX, NEARLY, MOSTLY = 16, 24, 0.5
"""JPEG smears the collar's edge over its blocks (16 px with halved colours): beside the fill lie pixels that are nearly it."""
FILLED, OF_COLLAR = 1, 2


def collar(pixels: Values) -> NDArray[np.bool_]:
    """Where a picture, (rows, cols) or (rows, cols, 3), shows nothing but one fill from there to its border: zero, or, of
    integers, the largest value of the type."""
    empty = np.zeros(pixels.shape[:2], np.bool_)
    for fill in (0, np.iinfo(pixels.dtype).max) if np.issubdtype(pixels.dtype, np.integer) else (0,):
        filled = pixels == fill
        if filled.ndim == 3:
            filled = filled.all(axis=2)
        of_fill = _reached_from_border(filled.astype(np.uint8))
        empty |= _widened(of_fill, pixels, fill) if pixels.dtype == np.uint8 else of_fill
    return empty


def _widened(empty: NDArray[np.bool_], pixels: Values, fill: int) -> NDArray[np.bool_]:
    """The collar, and the blocks at its border where a lossy compression has let content and fill run into each other."""
    ring = (cv2.dilate(empty.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0) & ~empty
    if not ring.any():
        return empty
    off = np.abs(pixels[ring].astype(np.int16) - fill)
    if float(((off if off.ndim == 1 else off.max(axis=1)) <= NEARLY).mean()) < MOSTLY:
        return empty
    side = 2 * LOSSY_BLOCK_PX + 1
    return np.asarray(cv2.dilate(empty.astype(np.uint8), np.ones((side, side), np.uint8)) > 0, dtype=np.bool_)


def _reached_from_border(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Of pixels that are FILLED, those of large patches that touch the border. Works on the picture."""
    border = np.ones(picture.shape, np.bool_)
    border[1:-1, 1:-1] = False
    for row, col in np.argwhere(border & (picture == FILLED)).tolist():
        if picture[row, col] == FILLED:
            area = cv2.floodFill(picture, None, (col, row), OF_COLLAR)[0]
            if area < LEAST_SHARE * picture.size:
                cv2.floodFill(picture, None, (col, row), 0)
    return np.asarray(picture == OF_COLLAR, dtype=np.bool_)
