"""The plane of best fit through heights of a raster."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray


def plane_through(design: FloatArray, heights: NDArray[Any]) -> FloatArray:
    """(3,) height at row and column 0, and its rise a row and a column, by least squares through the (N,) heights of cells."""
    z = heights.astype(np.float64)
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ z, rcond=None)[0], dtype=np.float64)


def design_of(rows: NDArray[np.intp], cols: NDArray[np.intp]) -> FloatArray:
    """(N, 3) what a plane's three numbers are multiplied with at (N,) cells."""
    return np.column_stack([np.ones(len(rows)), rows, cols])
