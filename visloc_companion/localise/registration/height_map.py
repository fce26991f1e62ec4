"""The upper surface of a cloud as a raster of heights with a mask.

A cell of the surface is the mean of the highest points of its parts: crowns and roofs from above, as stereo sees them, with the
gaps between crowns averaged in. The parts are as fine as the cloud's own density fills, so that a dense and a sparse cloud of one
place get the same surface. Raster frame: column to the east, row to the north (row 0 is the southernmost), metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.mapped.plane_fit import design_of, plane_through
from visloc_companion.types import FloatArray

SPIKE_M = 2.5
"""A part that stands out of all its neighbours by so much is an outlier."""
FEWEST_NEIGHBOURS = 4
ASIDE = 0.08
"""Points whose mean lies so far (in cells) from the middle of their cells are samples of a raster, not scattered."""
HIGH_PASS_M = 8.0
KNOWN_SHARE, FADED = 0.3, 0.02
"""Shares of a Gaussian's weight on known cells: of a smoothed cell that counts as known, and that has a height at all."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """`height_m` (H, W) float32, to be used where `known` (H, W); `corner_m` (2,) south-west corner of cell (0, 0)."""

    height_m: Float32Array
    known: Mask
    corner_m: FloatArray
    cell_m: float

    def cells_of(self, xy_m: FloatArray) -> FloatArray:
        """(N, 2) column and row, in cells from the centre of the first cell."""
        cells = np.asarray(xy_m - self.corner_m, dtype=np.float64)
        cells /= self.cell_m
        cells -= 0.5
        return cells

    def around(self, xy_m: FloatArray, half_m: float) -> HeightMap:
        """The part within a square about a place; empty where the two do not meet."""
        shape = np.array(self.known.shape[::-1])
        low, high = (np.clip(np.floor(self.cells_of(xy_m + side) + 0.5), 0, shape).astype(int) for side in (-half_m, half_m))
        at = (slice(low[1], high[1]), slice(low[0], high[0]))
        return HeightMap(self.height_m[at], self.known[at], self.corner_m + low * self.cell_m, self.cell_m)


def upper_surface(points_m: FloatArray, cell_m: float, parts: int) -> HeightMap:
    """The surface of (N, 3) points on cells of a size, each of so many parts along its side."""
    fine = _highest(points_m, cell_m, parts)
    weight = _without_spikes(fine).astype(np.float32)
    rows, cols = (n // parts for n in weight.shape)
    blocks = (rows, parts, cols, parts)
    count = weight.reshape(blocks).sum((1, 3))
    total = (np.where(weight > 0, fine.height_m, 0)).reshape(blocks).sum((1, 3))
    height = np.where(count > 0, total / np.maximum(count, 1), 0).astype(np.float32)
    return HeightMap(height, count > 0, fine.corner_m, cell_m)


def smoothed(heights: HeightMap, sigma_m: float, least: float = KNOWN_SHARE) -> HeightMap:
    """Gaussian mean of the known cells; known where these have at least that share of the weight. Fills gaps of about a cell.

    Heights go on a little beyond what is known, so that slopes at its border are those of the surface.
    """
    sigma = sigma_m / heights.cell_m
    weight = _blur(heights.known.astype(np.float32), sigma)
    height = _blur(np.where(heights.known, heights.height_m, 0), sigma) / np.maximum(weight, 1e-6)
    return HeightMap(np.where(weight > FADED, height, 0).astype(np.float32), weight > least, heights.corner_m, heights.cell_m)


def high_passed(heights: HeightMap, sigma_m: float = HIGH_PASS_M) -> HeightMap:
    """What stands out of the Gaussian mean of the known cells: neither tilt nor bowl nor a hill's side is left in it.

    The plane of best fit goes first: at the border, where the mean is one-sided, a slope would stand out.
    """
    flat = _without_plane(heights)
    low = smoothed(flat, sigma_m)
    rest = np.where(heights.known, flat.height_m - low.height_m, 0).astype(np.float32)
    return HeightMap(rest, heights.known, heights.corner_m, heights.cell_m)


def _without_plane(heights: HeightMap) -> HeightMap:
    rows, cols = np.nonzero(heights.known)
    if len(rows) < 3:
        return heights
    plane = plane_through(design_of(rows, cols), heights.height_m[rows, cols])
    u, v = np.arange(heights.known.shape[1]), np.arange(heights.known.shape[0])[:, None]
    flat = heights.height_m - (plane[0] + plane[1] * v + plane[2] * u)
    return HeightMap(flat.astype(np.float32), heights.known, heights.corner_m, heights.cell_m)


def _highest(points_m: FloatArray, cell_m: float, parts: int) -> HeightMap:
    """The highest point of each part of a cell; sides are whole cells."""
    part = cell_m / parts
    corner = np.array([_corner(points_m[:, axis], (cell_m, part)) for axis in (0, 1)])
    index = np.floor((points_m[:, :2] - corner) / part).astype(np.int64)
    cols, rows = (-(-(int(n) + 1) // parts) * parts for n in index.max(0))
    height = np.full(rows * cols, -np.inf, np.float32)
    np.maximum.at(height, index[:, 1] * cols + index[:, 0], points_m[:, 2].astype(np.float32))
    known = height > -np.inf
    shape = (rows, cols)
    return HeightMap(np.where(known, height, 0).reshape(shape), known.reshape(shape), corner, part)


def _corner(along_m: FloatArray, sides_m: tuple[float, ...]) -> float:
    """Where the first cell of an axis begins: at the first point, or before it where that leaves the points to one side of cells
    of one of these sides, the samples of a raster of which the side is a multiple, or of the side its spacing."""
    first = float(along_m.min())
    for side in sides_m:
        aside = float(np.mod((along_m - first) / side, 1).mean()) - 0.5
        if aside < -ASIDE:
            return first + aside * side
    return first


def _without_spikes(heights: HeightMap) -> Mask:
    """The known cells that do not stand out of their eight neighbours, where at least half of these are known."""
    ring = np.ones((3, 3), np.uint8)
    ring[1, 1] = 0
    far = np.float32(1e6)
    top = cv2.dilate(np.where(heights.known, heights.height_m, -far), ring)
    bottom = cv2.erode(np.where(heights.known, heights.height_m, far), ring)
    enough = cv2.filter2D(heights.known.astype(np.float32), -1, ring.astype(np.float32), borderType=cv2.BORDER_CONSTANT)
    out = (heights.height_m > top + SPIKE_M) | (heights.height_m < bottom - SPIKE_M)
    return np.asarray(heights.known & ~(out & (enough >= FEWEST_NEIGHBOURS)))


def _blur(values: Float32Array, sigma_px: float) -> Float32Array:
    if sigma_px < 0.05:
        return values
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
