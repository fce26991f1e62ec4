"""Small GeoTIFFs with known content, in any CRS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.maps.crs import map_crs
from visloc_companion.types import FloatArray, GeoPoint

WriteRaster = Callable[..., FloatArray]


@pytest.fixture
def write_raster() -> WriteRaster:
    """(path, values (H, W) or (H, W, C), crs, (lat, lon) of the middle, gsd_m, turn_deg) -> T_map_pix."""

    def write(
        path: Path, values: np.ndarray, crs: str, middle: tuple[float, float], gsd_m: float, turn_deg: float = 0.0, **profile: Any
    ) -> FloatArray:
        rows, cols = values.shape[:2]
        here = map_crs(crs).linearised_at(GeoPoint(*middle, 0.0))
        north, east = np.linalg.norm(here.J_map_ne, axis=0) * gsd_m
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        linear = np.array([[c, -s], [s, c]]) @ np.diag([east, -north])
        corner = np.array(here.origin_map_m) - linear @ [cols / 2, rows / 2]
        affine = Affine(*linear[0], corner[0], *linear[1], corner[1])
        bands = values[None] if values.ndim == 2 else values.transpose(2, 0, 1)
        shape = {"width": cols, "height": rows, "count": len(bands), "dtype": values.dtype}
        with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=affine, **shape, **profile) as out:
            out.write(bands)
        return T_map_pix_from_gdal(tuple(affine)[:6])

    return write
