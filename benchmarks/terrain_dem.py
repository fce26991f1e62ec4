"""A real elevation model for `benchmarks.terrain --dem`: `python -m benchmarks.terrain_dem FILE` writes it as a GeoTIFF.

The Jacksboro fault, Tennessee (SRTM at 3 arc seconds), from the sample data that matplotlib installs, in UTM zone 16 on cells
of 30 m.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib.cbook
import numpy as np
import rasterio
from rasterio.transform import from_bounds, from_origin
from rasterio.warp import Resampling, calculate_default_transform, reproject

CRS, CELL_M = "EPSG:32616", 30.0
WHOLE = 0.9
"""Rows and columns of which so much is known are kept: the corners are turned away."""


def main(argv: Sequence[str] | None = None) -> None:
    """Read, project, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, metavar="FILE")
    path = parser.parse_args(argv).file
    sample = matplotlib.cbook.get_sample_data("jacksboro_fault_dem.npz")
    heights = sample["elevation"].astype(np.float32)
    west, east, *parallels = (float(sample[name]) for name in ("xmin", "xmax", "ymin", "ymax"))
    south, north = sorted(parallels)
    rows, columns = heights.shape
    bounds = west, south, east, north
    transform, width, height = calculate_default_transform("EPSG:4326", CRS, columns, rows, *bounds, resolution=CELL_M)
    projected = np.full((height, width), np.nan, np.float32)
    of_sample = from_bounds(*bounds, columns, rows)
    reproject(
        heights,
        projected,
        src_transform=of_sample,
        src_crs="EPSG:4326",
        dst_transform=transform,
        dst_crs=CRS,
        resampling=Resampling.cubic,
        dst_nodata=np.nan,
    )
    known = np.isfinite(projected)
    (first_row, last_row), (first, last) = (np.flatnonzero(known.mean(axis) > WHOLE)[[0, -1]] for axis in (1, 0))
    kept = projected[first_row:last_row, first:last]
    at = from_origin(transform.c + first * CELL_M, transform.f - first_row * CELL_M, CELL_M, CELL_M)
    shape = {"height": kept.shape[0], "width": kept.shape[1], "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", driver="GTiff", crs=CRS, transform=at, nodata=np.nan, **shape) as out:
        out.write(kept, 1)


if __name__ == "__main__":
    main()
