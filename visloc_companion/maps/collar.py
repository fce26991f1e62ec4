"""The fill about an orthophoto that does not say where it is empty.

A survey is no rectangle, and a turned one leaves corners: without a nodata value, a mask or alpha they are black or white as any
other pixels. Frames at such a border are compared with the fill, and its outline looks like the edge of a field.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.maps.layer import Values

FILLS = (0, 255)
LEAST_SHARE = 1e-3
"""Of the picture: smaller patches of fill at its border are dark or bright things."""
FILLED, OF_COLLAR = 1, 2


def collar(pixels: Values) -> NDArray[np.bool_]:
    """Where a picture, (rows, cols) or (rows, cols, 3) of uint8, shows nothing but one fill from there to its border."""
    empty = np.zeros(pixels.shape[:2], np.bool_)
    for fill in FILLS:
        filled = pixels == fill
        if filled.ndim == 3:
            filled = filled.all(axis=2)
        empty |= _reached_from_border(filled.astype(np.uint8))
    return empty


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
