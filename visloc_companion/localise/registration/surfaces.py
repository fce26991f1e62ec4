"""What a refinement compares: the reference as a surface with slopes, the source as cells, and where the two meet."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.registration.height_map import HeightMap
from visloc_companion.localise.registration.similarity import moved
from visloc_companion.types import FloatArray

ROW = 1024
"""Places are looked up in rows of so many: OpenCV takes no wider ones than 32,767."""
IN_REFERENCE = 0.7
"""Interpolated `known` from which a place counts as on the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A reference for refinement: (H, W, 4) height, its slope to the east and north, known or not; of `heights`."""

    layers: Float32Array
    heights: HeightMap

    def at(self, xy_m: FloatArray) -> Float32Array:
        """(N, 4) the layers at places (N, 2)."""
        return looked_up(self.layers, self.heights.cells_of(xy_m), cv2.INTER_CUBIC)


@dataclass(frozen=True, slots=True, eq=False)
class SourceCells:
    """The source's known cells as points (N, 3), their relief (N,), the height (N,) of a bowl of 1 m at each, and
    where they are in the map's `shape`."""

    points_m: FloatArray
    relief_m: FloatArray
    centre_m: FloatArray
    bowl: FloatArray
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """Cells that a similarity puts on a surface: which are `used` (N,) and, of these, where they are (n, 3), how far that is
    from the source's middle (n, 3), and the surface's `height_m` (n,) and slopes `east`, `north` (n,) there."""

    used: Mask
    at_m: FloatArray
    out_m: FloatArray
    height_m: FloatArray
    east: FloatArray
    north: FloatArray


def looked_up(layers: Float32Array, cells: FloatArray, interpolation: int) -> Float32Array:
    """(N, K) layers (H, W, K) interpolated at cells (N, 2), column and row; 0 beyond them."""
    n, rows = len(cells), -(-len(cells) // ROW)
    at = np.full((2, rows * ROW), -10, np.float32)
    at[:, :n] = cells.T
    u, v = at.reshape(2, rows, ROW)
    found = cv2.remap(layers, u, v, interpolation, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found.reshape(-1, layers.shape[2])[:n], dtype=np.float32)


def central_slopes(heights: HeightMap) -> tuple[Float32Array, Float32Array]:
    """(H, W) slopes to the east and to the north by central differences; 0 at the border."""
    h, step = heights.height_m, np.float32(0.5 / heights.cell_m)
    east, north = np.zeros_like(h), np.zeros_like(h)
    east[:, 1:-1] = (h[:, 2:] - h[:, :-2]) * step
    north[1:-1] = (h[2:] - h[:-2]) * step
    return east, north


def surface_of(heights: HeightMap) -> Surface:
    """With its slopes."""
    return Surface(np.stack([heights.height_m, *central_slopes(heights), heights.known.astype(np.float32)], -1), heights)


def cells_of(heights: HeightMap, relief: HeightMap, centre_m: FloatArray) -> SourceCells:
    """The known cells of the source's map, which are those of its relief."""
    rows, cols = np.nonzero(heights.known)
    xy = np.column_stack([cols, rows]) * heights.cell_m + heights.corner_m + heights.cell_m / 2
    points = np.column_stack([xy, heights.height_m[rows, cols].astype(np.float64)])
    out = points[:, :2] - centre_m[:2]
    squared = (out**2).sum(1)
    bowl = squared / max(2 * float(squared.mean()), 1e-9)
    bowl -= float(bowl.mean())
    own = relief.height_m[rows, cols].astype(np.float64)
    return SourceCells(points, own, centre_m, bowl, rows, cols, heights.known.shape)


def met(source: SourceCells, surface: Surface, T: FloatArray, bowl_m: float = 0.0) -> Met:
    """The source's cells, bowled by so much and moved by T, on a surface."""
    points = source.points_m
    if bowl_m:
        points = points.copy()
        points[:, 2] += bowl_m * source.bowl
    at = moved(T, points)
    layers = surface.at(at[:, :2])
    used = np.asarray(layers[:, 3] > IN_REFERENCE)
    if not used.all():
        at, layers = at[used], layers[used]
    height, east, north = np.ascontiguousarray(layers[:, :3].T, dtype=np.float64)
    return Met(used, at, at - moved(T, source.centre_m), height, east, north)
