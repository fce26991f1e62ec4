"""Point clouds (.las, .laz) to a surface model: the highest point of every cell."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.geotiff import ground_gsd_m
from visloc_companion.maps.layer import array_layer
from visloc_companion.prepare.target import Source

NOISE_CLASSES = (7, 18)
"""ASPRS LAS 1.4: low point, high noise."""
POINTS_PER_CELL = 3.0
CELL_M = (0.25, 5.0)
_CHUNK = 2_000_000
MAX_CELLS = 400_000_000


def cloud_surface(path: Path, crs_text: str = "") -> Source:
    """Upper surface of a cloud in its own CRS, heights in metres.

    The cell holds about three points. `crs_text` (EPSG:CODE or WKT) serves where the file states no CRS.
    Raises MapError for a file that cannot be read, DatumMissing for one without a CRS.
    """
    laspy = _laspy(path)
    if not path.is_file():
        raise MapError("there is no such file", where=str(path), remedy="name a .las or .laz file")
    try:
        with laspy.open(path) as reader:
            return _rasterised(path, reader, crs_text)
    except (laspy.errors.LaspyException, OSError, ValueError, EOFError, RuntimeError) as why:
        raise MapError(f"cannot be read as a point cloud: {why}", where=str(path), remedy="copy the file again") from why


def _laspy(path: Path) -> Any:
    try:
        import laspy
    except ImportError as why:
        raise MapError(
            "reading point clouds needs laspy", where=str(path), remedy="pip install 'visloc-companion[prep]', or give --dsm"
        ) from why
    return laspy


def _rasterised(path: Path, reader: Any, crs_text: str) -> Source:
    header = reader.header
    found = header.parse_crs()
    if found is None and not crs_text:
        raise DatumMissing("has no coordinate reference system", where=str(path), remedy="--cloud-crs EPSG:CODE")
    crs = map_crs(crs_text if found is None else found.to_wkt(), str(path))
    if crs.is_geographic:
        raise MapError("is in degrees", where=str(path), remedy="reproject it to a CRS in metres (pdal, las2las)")
    low, high = np.array(header.mins[:2]), np.array(header.maxs[:2])
    extent = np.maximum(high - low, 1e-3)
    unit_m = crs.metres_per_unit
    spacing_m = math.sqrt(float(extent[0] * extent[1]) * unit_m**2 * POINTS_PER_CELL / max(1, header.point_count))
    cell = min(max(spacing_m, CELL_M[0]), CELL_M[1]) / unit_m
    cols, rows = (int(n) for n in np.floor(extent / cell) + 1)
    if rows * cols > MAX_CELLS:
        raise MapError(f"spans {cols} x {rows} cells", where=str(path), remedy="cut it into smaller clouds, or give --dsm")
    top = np.full(rows * cols, -np.inf, np.float32)
    for points in reader.chunk_iterator(_CHUNK):
        _raise_cells(top, points, low, high, cell, cols)
    heights = top.reshape(rows, cols)
    known = np.isfinite(heights)
    if not known.any():
        raise MapError("holds no point that is a surface", where=str(path), remedy="name a cloud with content")
    T_map_pix = T_map_pix_from_gdal((cell, 0.0, float(low[0]), 0.0, -cell, float(high[1])))
    metres = np.where(known, heights * np.float32(crs.vertical_metres_per_unit), np.float32(0))
    return Source(str(path), array_layer(T_map_pix, metres, known), crs, ground_gsd_m(crs, T_map_pix, (rows, cols)))


def _raise_cells(
    top: NDArray[np.float32], points: Any, low: NDArray[np.float64], high: NDArray[np.float64], cell: float, cols: int
) -> None:
    keep = ~np.isin(np.asarray(points.classification), NOISE_CLASSES)
    x, y, z = (np.asarray(axis)[keep] for axis in (points.x, points.y, points.z))
    column = np.clip(((x - low[0]) / cell).astype(np.int64), 0, cols - 1)
    row = np.clip(((high[1] - y) / cell).astype(np.int64), 0, len(top) // cols - 1)
    np.maximum.at(top, row * cols + column, z.astype(np.float32))
