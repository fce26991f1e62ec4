"""By how much the content of two images of one place is apart."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.parabola import peak_offset

REACH_PX = 5
Array = NDArray[np.float64]


def shift_px(a: NDArray[np.float32], b: NDArray[np.float32], centre: tuple[float, float], side_px: int) -> Array | None:
    """(2,) columns and rows from a's window to where b shows the same; None off the image or with the peak at the rim."""
    half = side_px // 2
    col, row = (round(x) - half for x in centre)
    height, width = a.shape[:2]
    if min(col, row) < REACH_PX or col + side_px + REACH_PX > width or row + side_px + REACH_PX > height:
        return None
    window = np.ascontiguousarray(a[row : row + side_px, col : col + side_px])
    there = b[row - REACH_PX : row + side_px + REACH_PX, col - REACH_PX : col + side_px + REACH_PX]
    scores = cv2.matchTemplate(np.ascontiguousarray(there), window, cv2.TM_CCORR_NORMED).astype(np.float64)
    r, c = (int(k) for k in np.unravel_index(int(scores.argmax()), scores.shape))
    if not (0 < r < 2 * REACH_PX and 0 < c < 2 * REACH_PX):
        return None
    right, down = peak_offset(scores, r, c)
    return np.array([c + right - REACH_PX, r + down - REACH_PX])
