"""How well the parts of the source, each compared on its own, agree with the reference at the places of a region.

One correlation of the whole is made by what stands highest: a single house, or a crown that has grown, can carry it to a wrong
place, and what was felled or built takes it down at the right one. Parts have levels and gains of their own, and each counts by
its size, not by its relief. The mean over them of Fisher's z (atanh of the correlation, whose errors are alike everywhere) is
high where many agree, whatever made the place be found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.registration.correlation import LEAST_DEVIATION_M, Template
from visloc_companion.localise.registration.pair import Pair
from visloc_companion.localise.registration.search import reach_of, template
from visloc_companion.localise.registration.similarity import scale_of, yaw_of
from visloc_companion.types import FloatArray

Cells = NDArray[np.int_]
"""(2,) column and row."""

PARTS = 4
"""Along each side: 17 m of a source of 67 m."""
LEAST_KNOWN = 0.5
"""Share of its cells that a part must know."""
MOST = 0.98
"""No more correlation than this is told from a better one."""
LEAST_CHANCE, MOST_RARE = 0.02, 8.0
"""Root mean square of a part's z that it has by chance at least; how often that counts at most."""


def z_of(correlation: Float32Array) -> Float32Array:
    """Fisher's z of a correlation, of what is none or less 0."""
    return np.asarray(np.arctanh(np.clip(correlation, 0, np.float32(MOST))), dtype=np.float32)


def mean_z(pair: Pair, T: FloatArray, low: Cells, high: Cells) -> Float32Array:
    """(rows, cols) mean z of the parts at the places of a box of the reference's cells, each part by its number of cells."""
    total, number = _nothing(low, high), 0
    for cells, z in _z_of_parts(pair, T, low, high):
        total += np.float32(cells) * z
        number += cells
    return total / np.float32(max(number, 1))


def means(pair: Pair, T: FloatArray, low: Cells, high: Cells) -> tuple[Float32Array, Float32Array]:
    """(rows, cols) each: `mean_z`, and the mean of the z of each part over what it has by chance: its root mean square over the
    places of the box where it correlates at all."""
    total, rare, number = _nothing(low, high), _nothing(low, high), 0
    for cells, z in _z_of_parts(pair, T, low, high):
        chance = math.sqrt(float(np.square(z).sum()) / max(int(np.count_nonzero(z)), 1))
        total += np.float32(cells) * z
        rare += np.float32(cells) * np.minimum(z / np.float32(max(chance, LEAST_CHANCE)), np.float32(MOST_RARE))
        number += cells
    least = np.float32(max(number, 1))
    return total / least, rare / least


def _nothing(low: Cells, high: Cells) -> Float32Array:
    return np.zeros((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), np.float32)


def _z_of_parts(pair: Pair, T: FloatArray, low: Cells, high: Cells) -> Iterator[tuple[int, Float32Array]]:
    """Of each part its number of cells, and (rows, cols) its z at the places of a box of the reference's cells."""
    yaw, scale, cell = yaw_of(T), scale_of(T), pair.reference.cell_m
    reach = reach_of(pair, [(yaw, scale)])
    around = _around(pair, low - reach, high + reach)
    rows, cols = int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1
    for row, col, part in _split(template(pair.source_relief, pair.centre_m, yaw, scale, cell, reach)):
        beside = around[row : row + rows + part.known.shape[0] - 1, col : col + cols + part.known.shape[1] - 1]
        cells = int(part.known.sum())
        yield cells, z_of(_correlation(part, beside, cells))


def _around(pair: Pair, low: Cells, high: Cells) -> Float32Array:
    """The reference's relief on a box of its cells, 0 where it is not known."""
    relief = np.where(pair.reference_relief.known, pair.reference_relief.height_m, np.float32(0))
    shape = relief.shape[::-1]
    before, after = np.maximum(-low, 0), np.maximum(high + 1 - shape, 0)
    wide = np.pad(relief, ((int(before[1]), int(after[1])), (int(before[0]), int(after[0]))))
    (u0, v0), (u1, v1) = low + before, high + before + 1
    return np.ascontiguousarray(wide[v0:v1, u0:u1], dtype=np.float32)


def _split(whole: Template) -> Iterator[tuple[int, int, Template]]:
    """First row and column of each part that knows enough, and the part; its heights less their mean."""
    rows, cols = (np.nonzero(whole.known.any(axis))[0] for axis in (1, 0))
    if not len(rows):
        return
    edges = [np.linspace(some[0], some[-1] + 1, PARTS + 1).round().astype(int) for some in (rows, cols)]
    for r0, r1 in zip(edges[0][:-1], edges[0][1:], strict=True):
        for c0, c1 in zip(edges[1][:-1], edges[1][1:], strict=True):
            known, height = whole.known[r0:r1, c0:c1], whole.height_m[r0:r1, c0:c1]
            if known.sum() > LEAST_KNOWN * known.size:
                level = np.where(known, height - height[known].mean(), 0).astype(np.float32)
                yield int(r0), int(c0), Template(level, known, (0, 0))


def _correlation(part: Template, beside: Float32Array, cells: int) -> Float32Array:
    """Of a part of so many known cells with the relief beside it, at every place at which it lies within."""
    h, w = part.known.shape
    product = cv2.matchTemplate(beside, part.height_m, cv2.TM_CCORR) / np.float32(cells)
    middle = (slice(h // 2, h // 2 + product.shape[0]), slice(w // 2, w // 2 + product.shape[1]))
    mean, square = (cv2.boxFilter(a, -1, (w, h), borderType=cv2.BORDER_CONSTANT)[middle] for a in (beside, np.square(beside)))
    least = np.float32(LEAST_DEVIATION_M**2)
    own = np.float32(np.square(part.height_m).sum() / cells)
    return np.asarray(product / np.sqrt((np.maximum(square - np.square(mean), 0) + least) * (own + least)), dtype=np.float32)
