"""Opening rasters, those whose place stands in a world file beside them included.

GDAL believes what a GeoTIFF holds before the world file beside it. Some programs write the place into the world file alone and
into the GeoTIFF the grid of its pixels, one by one from (0, 0): that is no place, and does not stand against one that is stated.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import NotGeoreferencedWarning

_WORLD_FILE_FIRST = "WORLDFILE,PAM,INTERNAL,TABFILE"
_HALF = 0.5
"""Where the coordinates are those of the pixels' centres, the corner lies so far beside (0, 0)."""


def open_raster(path: Path) -> Any:
    """The open dataset, by its world file where it states but its pixels itself. Raises RasterioError."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        dataset = rasterio.open(path)
        if dataset.driver == "GTiff" and is_pixel_grid(dataset):
            dataset.close()
            dataset = rasterio.open(path, GEOREF_SOURCES=_WORLD_FILE_FIRST)
    return dataset


@contextmanager
def as_hashed() -> Iterator[None]:
    """Rasters that are opened within are what their own bytes say, whatever lies beside them: programs that show a raster write
    .aux.xml (scale, unit, nodata value, CRS), .msk and .ovr beside it, which GDAL believes and no manifest names."""
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR", GDAL_PAM_ENABLED="NO"):
        yield


def is_pixel_grid(dataset: Any) -> bool:
    """Whether an open raster's georeference, if it is one, only counts its pixels from a corner at (0, 0)."""
    a, b, c, d, e, f = tuple(dataset.transform)[:6]
    at_corner = abs(c) <= _HALF and (abs(f) <= _HALF or abs(f - dataset.height) <= _HALF)
    return (a, b, d, abs(e)) == (1.0, 0.0, 0.0, 1.0) and at_corner
