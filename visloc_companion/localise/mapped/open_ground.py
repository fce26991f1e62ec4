"""The ground between the samples of a coarse surface model as unknowns of an alignment, beside the camera's pose.

Hills that the surface model does not have shift what the frame shows of them away from the nadir or towards it, and an alignment
that takes the model for true explains them by a tilt, a height and a place. Heights of square cells, with the covariance that the
surface model's errors have (surface_error.py), are solved for with the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.mapped.surface_error import height_covariance
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.types import FloatArray

CELLS = 12
"""Along the longer side of a window."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenGround:
    """N cells, row by row: `cells` (H, W) has the number of each pixel's, (rows, columns) of them with sides of `side_px`;
    `information` (N, N) is the inverse covariance (1/m²) of the surface model's errors, `raised_m` (N,) by how much the ground is
    taken to be higher than that model."""

    cells: NDArray[np.intp]
    shape: tuple[int, int]
    side_px: int
    information: FloatArray
    raised_m: FloatArray

    def raised(self, raised_m: FloatArray) -> OpenGround:
        """The same cells, raised by (N,) metres."""
        return replace(self, raised_m=raised_m)

    def on(self, grid: MapGrid) -> MapGrid:
        """The window with its surface raised, evenly from cell to cell."""
        height, width = grid.weight.shape
        (rows, cols), side = self.shape, self.side_px
        by_cell = self.raised_m.reshape(rows, cols).astype(np.float32)
        up = cv2.resize(by_cell, (cols * side, rows * side), interpolation=cv2.INTER_LINEAR)[:height, :width]
        return replace(grid, surface_up_m=np.asarray(grid.surface_up_m + up, dtype=np.float32))

    def summed(self, images: Float32Array, weight: Float32Array, stride: int) -> FloatArray:
        """(N, K) sums of images (K, P) under a weight (P,) over each cell; P: every `stride`-th pixel of both axes."""
        cells = self.cells[::stride, ::stride].ravel()
        return np.stack([np.bincount(cells, image * weight, len(self.raised_m)) for image in images], axis=1)


def open_ground(grid: MapGrid) -> OpenGround:
    """The cells of a window, not raised."""
    height, width = grid.weight.shape
    side = math.ceil(max(height, width) / CELLS)
    rows, cols = -(-height // side), -(-width // side)
    cells = (np.arange(height) // side)[:, None] * cols + np.arange(width) // side
    v, u = np.indices((rows, cols)).reshape(2, -1) * side + (side - 1) / 2
    information = np.linalg.inv(height_covariance(grid, np.column_stack([u, v]), side))
    return OpenGround(cells, (rows, cols), side, np.asarray(information, dtype=np.float64), np.zeros(rows * cols))
