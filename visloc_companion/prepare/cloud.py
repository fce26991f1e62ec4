"""Point clouds (.las, .laz) to a surface model: the highest point of every cell."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import CloudError, DatumMissing
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.maps.cloud_las import LasFile, open_las
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.filled import fill_holes
from visloc_companion.maps.fills import HEIGHTS_M
from visloc_companion.maps.ground_pixel import ground_gsd_m
from visloc_companion.maps.layer import array_layer
from visloc_companion.maps.wild import surface_mask
from visloc_companion.prepare.target import Source
from visloc_companion.types import FloatArray

POINTS_PER_CELL = 3.0
CELL_M = (0.25, 5.0)
MISSED_PX = 1
"""Of cells that hold three points on average one in twenty holds none: no hole of the surface."""
MAX_CELLS = 80_000_000
"""Heights, mask and levels of as many cells take 0.8 GB."""
WILD_BLOCK = 1024
"""Cells on a side among which points that lie alone are looked for at once (200 MB)."""


def cloud_surface(path: Path, crs_text: str = "") -> Source:
    """Upper surface of a cloud in its own CRS, heights in metres.

    The cell holds about three points. `crs_text` (EPSG:CODE or WKT) serves where the file states no CRS.
    Raises CloudError for a file that cannot be read, DatumMissing for one without a CRS.
    """
    with open_las(path, crs_text) as las:
        return _rasterised(las, stated_crs(las))


def stated_crs(las: LasFile) -> MapCrs:
    """The CRS of a cloud. Raises DatumMissing where there is none."""
    if las.crs is None:
        raise DatumMissing("has no coordinate reference system", where=str(las.path), remedy="--cloud-crs EPSG:CODE")
    return las.crs


def _rasterised(las: LasFile, crs: MapCrs) -> Source:
    low, high = las.low[:2], las.high[:2]
    extent = np.maximum(high - low, 1e-3)
    unit_m = crs.metres_per_unit
    spacing_m = math.sqrt(float(extent[0] * extent[1]) * unit_m**2 * POINTS_PER_CELL / las.point_count)
    cell = min(max(spacing_m, CELL_M[0]), CELL_M[1]) / unit_m
    cols, rows = (math.floor(length / cell) + 1 for length in extent)
    if rows * cols > MAX_CELLS:
        raise CloudError(f"spans {cols} x {rows} cells", where=str(las.path), remedy="cut it into smaller clouds, or give --dsm")
    top = np.full(rows * cols, -np.inf, np.float32)
    for points in las.chunks():
        _check_bounds(points, las, cell)
        _raise_cells(top, points[on_land(points[:, 2] * las.height_unit_m)], low, high, cell, cols)
    heights = top.reshape(rows, cols)
    known = np.isfinite(heights)
    _drop_wild(heights, known, cell * unit_m, las.height_unit_m)
    if not known.any():
        raise CloudError("holds no point that is a surface", where=str(las.path), remedy="name a cloud with content")
    T_map_pix = T_map_pix_from_gdal((cell, 0.0, float(low[0]), 0.0, -cell, float(high[1])))
    heights *= np.float32(las.height_unit_m)
    fill_holes(heights, known, MISSED_PX)
    heights[~known] = 0
    gsd_m = ground_gsd_m(crs, T_map_pix, (rows, cols), str(las.path))
    return Source(str(las.path), array_layer(T_map_pix, heights, known), crs, gsd_m)


def on_land(heights_m: FloatArray) -> NDArray[np.bool_]:
    """(N,) which heights land can have; a surface model's are judged so, too."""
    return np.asarray((heights_m >= HEIGHTS_M[0]) & (heights_m <= HEIGHTS_M[1]))


def _check_bounds(points: FloatArray, las: LasFile, cell: float) -> None:
    """Raise CloudError where points (N, 3) lie outside of the header's bounds, which the grid of cells is made from."""
    beyond = (points[:, :2] < las.low[:2] - cell) | (points[:, :2] > las.high[:2] + cell)
    if beyond.any():
        easting, northing = points[int(np.argmax(beyond.any(axis=1))), :2]
        raise CloudError(
            f"header: its bounds do not hold all points, such as that at {easting:.2f}, {northing:.2f}",
            where=str(las.path),
            remedy="write it anew (las2las, pdal translate)",
        )


def _raise_cells(top: NDArray[np.float32], points: FloatArray, low: FloatArray, high: FloatArray, cell: float, cols: int) -> None:
    column = np.clip(((points[:, 0] - low[0]) / cell).astype(np.int64), 0, cols - 1)
    row = np.clip(((high[1] - points[:, 1]) / cell).astype(np.int64), 0, len(top) // cols - 1)
    np.maximum.at(top, row * cols + column, points[:, 2].astype(np.float32))


def _drop_wild(heights: NDArray[np.float32], known: NDArray[np.bool_], cell_m: float, height_unit_m: float) -> None:
    """Take from `known` (rows, cols) the cells whose highest point lies alone in the air or in the ground, block by block."""
    for top in range(0, known.shape[0], WILD_BLOCK):
        for left in range(0, known.shape[1], WILD_BLOCK):
            block = known[top : top + WILD_BLOCK, left : left + WILD_BLOCK]
            rows, cols = np.nonzero(block)
            if len(rows):
                up_m = heights[top + rows, left + cols].astype(np.float64) * height_unit_m
                block[rows, cols] = surface_mask(np.column_stack([cols * cell_m, rows * cell_m, up_m]))
