"""Holes of a few pixels in an orthophoto: dark ground that has the value which the file declares as "nothing".

With a nodata value of 0 every pixel that is black in all bands is missing, in shade and on wet roofs as well as about the
picture, and features see nothing within 3 px of one (localise/features).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.maps.geotiff import nodata_of
from visloc_companion.maps.layer import Layer
from visloc_companion.prepare.target import Source

LARGEST_PX = 100
"""A hole of fewer pixels is a speck; larger ones may be water, or where nobody took pictures."""
REACH_PX, RIM_PX = 3, 16
"""So much about a speck features do not see; beside a larger hole specks are its ragged rim."""
TOLD_SHARE = 0.01
"""What less of the picture than this is lost to is not worth a word."""
WINDOWS, WINDOW_PX = 8, 512
"""At most so many windows of such a side are looked at along rows and along columns."""


def specks(sources: Sequence[Source], paths: Sequence[Path]) -> list[str]:
    """A sentence on each orthophoto (`sources`, of the files `paths`) that declares a nodata value and loses more than TOLD_SHARE
    of its content to specks of it. Raises MapError for damaged pixels."""
    found: list[str] = []
    for source, path in zip(sources, paths, strict=True):
        value = nodata_of(path)
        missing, alone, lost = (0.0, 0.0, 0.0) if value is None else _shares(source.layer)
        if lost > TOLD_SHARE:
            found.append(
                f"{source.name} lacks {missing:.1%} of its pixels, {alone:.1%} in specks where the ground has its nodata value "
                f"{value:g}, and features lose {lost:.1%} of it: gdal_edit.py -unsetnodata FILE (what is empty about its content "
                "is found without; of more than 400 MB mark that before: nearblack -near 0 -setmask -o NEW.tif FILE)"
            )
    return found


def _shares(layer: Layer) -> tuple[float, float, float]:
    """What is missing and what is so in specks, of all pixels that were looked at, and what these cost of those shown."""
    n = n_missing = n_specks = n_content = n_lost = 0
    for rows, cols in _windows(layer.shapes[0]):
        valid = layer.read(0, rows, cols)[1] > 0
        n += valid.size
        n_missing += valid.size - int(valid.sum())
        if not valid.any() or valid.all():
            n_content += int(valid.sum())
            continue
        small, large = _holes(valid)
        seen = ~_grown(large, REACH_PX)
        n_specks += int(small.sum())
        n_content += int(seen.sum())
        n_lost += int((_grown(small, REACH_PX) & seen).sum())
    return n_missing / n, n_specks / n, n_lost / max(1, n_content)


def _windows(shape: tuple[int, int]) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """(top, bottom), (left, right) of what is looked at of a raster of (rows, cols): all of it, or windows spread over it."""

    def spans(size: int) -> list[tuple[int, int]]:
        count = min(WINDOWS, -(-size // WINDOW_PX))
        side = min(WINDOW_PX, -(-size // count))
        return [(at, at + side) for at in np.linspace(0, size - side, count).astype(int).tolist()]

    yield from product(spans(shape[0]), spans(shape[1]))


def _holes(valid: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Where (rows, cols) holes are specks, and where they are larger; small ones that the window cuts may be part of either, and
    count as neither."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~valid).astype(np.uint8), connectivity=8)
    is_speck = stats[:, cv2.CC_STAT_AREA] < LARGEST_PX
    large = ~is_speck[labels] & ~valid
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        is_speck[edge] = False
    return is_speck[labels] & ~valid & ~_grown(large, RIM_PX), large


def _grown(mask: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((2 * by_px + 1,) * 2, np.uint8)) > 0, dtype=np.bool_)
