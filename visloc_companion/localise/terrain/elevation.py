"""Elevation models: a raster with its transform, windows of it on a north-east grid, and heights and slopes at places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import scipy.ndimage  # type: ignore[import-untyped]

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.types import FloatArray, ReferencePatch, Vec2

KNOWN = 0.999
"""Bilinear weight of known cells from which a place counts as known."""


@dataclass(frozen=True, eq=False)
class ElevationMap:
    """Heights above sea level (H, W), NaN where void; `T_ne_pix` (2, 3) maps pix (u, v) to metres north, east of the filter's
    origin; `sigma_m` is the 1-sigma of a height, `sigma_ne_m` that of the whole model's place, each axis.

    A fix claims `sigma_ne_m` once. A filter that takes many fixes must not average it away: give it 0 here, and add it to what
    is stated. Raises ValueError for another shape, a singular transform or a sigma that is not positive.
    """

    height_amsl_m: Float32Array
    T_ne_pix: FloatArray
    sigma_m: float
    sigma_ne_m: float = 0.0

    def __post_init__(self) -> None:
        if self.height_amsl_m.ndim != 2 or self.T_ne_pix.shape != (2, 3):
            raise ValueError(
                f"elevations are (H, W) with a (2, 3) transform, got {self.height_amsl_m.shape}, {self.T_ne_pix.shape}"
            )
        if not self.sigma_m > 0 or not self.cell_m > 0:
            raise ValueError(f"elevations with sigma {self.sigma_m} m on cells of {self.cell_m} m: both must be positive")

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres (geometric mean)."""
        return math.sqrt(abs(float(np.linalg.det(self.T_ne_pix[:, :2]))))

    def window(self, centre_ne_m: Vec2, half_m: Vec2, cell_m: float) -> Terrain:
        """The elevations within `half_m` (north, east) of a centre on cells of a size, area means where these are coarser."""
        shape = tuple(2 * math.ceil(half / cell_m) + 1 for half in half_m)
        first = np.array([centre - (n // 2) * cell_m for centre, n in zip(centre_ne_m, shape, strict=True)])
        T_ne_window = np.array([[0.0, cell_m, first[0]], [cell_m, 0.0, first[1]]])
        return Terrain(*self._sampled(T_ne_window, shape), first, cell_m)

    def _sampled(self, T_ne_window: FloatArray, shape: tuple[int, ...]) -> tuple[Float32Array, Mask]:
        T_pix_ne = invert_affine(self.T_ne_pix)
        v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
        pix = apply_affine(T_pix_ne, apply_affine(T_ne_window, np.stack([u, v], -1).astype(np.float64)))
        height, width = self.height_amsl_m.shape
        low = np.maximum(np.floor(pix.reshape(-1, 2).min(0)).astype(int) - 3, 0)
        high = np.minimum(np.ceil(pix.reshape(-1, 2).max(0)).astype(int) + 4, [width, height])
        if (high - low < 2).any():
            return np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
        part = np.asarray(self.height_amsl_m[low[1] : high[1], low[0] : high[0]], np.float32)
        known = np.isfinite(part)
        if not known.any():
            return np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
        filled = _filled(part, known)
        sigma = 0.5 * math.sqrt(max(0.0, (T_ne_window[1, 0] / self.cell_m) ** 2 - 1.0))
        if sigma > 0.3:
            filled = np.asarray(cv2.GaussianBlur(filled, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), np.float32)
        at = np.moveaxis(pix - low, -1, 0)[::-1]
        values = scipy.ndimage.map_coordinates(filled, at, order=3, mode="nearest", output=np.float32)
        share = scipy.ndimage.map_coordinates(known.astype(np.float32), at, order=1, mode="constant", output=np.float32)
        return values, share > KNOWN


@dataclass(frozen=True, eq=False)
class Terrain:
    """A window: heights (R, C) with a mask, row to the north, column to the east, centre of cell (0, 0) at `first_ne_m` (2,)."""

    height_amsl_m: Float32Array
    known: Mask
    first_ne_m: FloatArray
    cell_m: float

    @cached_property
    def _spline(self) -> FloatArray:
        filled = _filled(self.height_amsl_m, self.known) if self.known.any() else self.height_amsl_m
        return np.asarray(scipy.ndimage.spline_filter(filled.astype(np.float64), order=3, mode="nearest"))

    def heights(self, ne_m: FloatArray) -> FloatArray:
        """(N,) heights at (N, 2) places by cubic splines; what lies outside or in voids is extended (see `knows`)."""
        at = ((ne_m - self.first_ne_m) / self.cell_m).T
        return np.asarray(scipy.ndimage.map_coordinates(self._spline, at, order=3, mode="nearest", prefilter=False))

    def heights_and_slopes(self, ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) heights and (N, 2) slopes to the north and east (metres a metre) over half a cell to either side."""
        step = self.cell_m / 2
        shifts = np.array([[0, 0], [step, 0], [-step, 0], [0, step], [0, -step]])
        here, n1, n0, e1, e0 = self.heights((ne_m[None] + shifts[:, None]).reshape(-1, 2)).reshape(5, -1)
        return here, np.column_stack([n1 - n0, e1 - e0]) / (2 * step)

    def knows(self, ne_m: FloatArray) -> Mask:
        """(N,) whether all cells about a place are known."""
        at = ((ne_m - self.first_ne_m) / self.cell_m).T
        share = scipy.ndimage.map_coordinates(self.known.astype(np.float32), at, order=1, mode="constant")
        return np.asarray(share > KNOWN)

    def slope_rms(self) -> float:
        """Root mean square slope of the known cells, per axis; 0 where there are none side by side."""
        squares = []
        for axis in (0, 1):
            both = self.known.take(range(1, self.known.shape[axis]), axis) & self.known.take(
                range(self.known.shape[axis] - 1), axis
            )
            squares.append(np.square(np.diff(self.height_amsl_m, axis=axis)[both] / self.cell_m))
        every = np.concatenate(squares)
        return math.sqrt(float(every.mean())) if every.size else 0.0


def elevation_of(patch: ReferencePatch, frame: LocalFrame, sigma_m: float, sigma_ne_m: float = 0.0) -> ElevationMap:
    """The surface heights of a window of a reference map, in metres north and east of the frame's origin."""
    heights = np.where(patch.valid, patch.dsm_amsl_m, np.nan).astype(np.float32)
    return ElevationMap(heights, frame.A_ne_pix(patch.T_map_pix), sigma_m, sigma_ne_m)


def _filled(heights: Float32Array, known: Mask) -> Float32Array:
    """Voids take the nearest known height, so that a spline does not ring about them."""
    if known.all():
        return heights
    nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(heights[tuple(nearest)], dtype=np.float32)
