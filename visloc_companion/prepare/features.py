"""Features of the map, computed once: one memory-mappable array for each GSD, a factor of the square root of 2 apart."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap

from visloc_companion.geo.raster import T_map_pix_from_gdal, compose_affine
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.layer import Layer
from visloc_companion.maps.manifest import FeatureLevel
from visloc_companion.maps.warp import warp_affine
from visloc_companion.prepare.mosaic import Step
from visloc_companion.prepare.target import TargetGrid

SMALLEST_PX = 48
_TILE_PX = 1024
_MARGIN_PX = GRADIENT.context_px
_STEP = GRADIENT.bound / 127


def level_grids(grid: TargetGrid) -> Iterator[tuple[float, int, int]]:
    """(pixel in map units, rows, cols) of each level: pixels grow by the square root of 2 from the map's own."""
    k = 0
    while True:
        factor = math.sqrt(2) ** k
        rows, cols = int(grid.rows / factor), int(grid.cols / factor)
        if k and min(rows, cols) < SMALLEST_PX:
            return
        yield grid.pixel * factor, rows, cols
        k += 1


def total_pixels(grid: TargetGrid) -> int:
    """Pixels of all levels."""
    return sum(rows * cols for _, rows, cols in level_grids(grid))


def write_features(folder: Path, grid: TargetGrid, pixels: Layer, step: Step) -> tuple[FeatureLevel, ...]:
    """Write all levels and return what the manifest says of them."""
    return tuple(_write_level(folder, k, grid, shape, pixels, step) for k, shape in enumerate(level_grids(grid)))


def _write_level(
    folder: Path, k: int, grid: TargetGrid, shape: tuple[float, int, int], pixels: Layer, step: Step
) -> FeatureLevel:
    pixel, rows, cols = shape
    transform = (pixel, 0.0, grid.west, 0.0, -pixel, grid.north)
    T_map_pix = T_map_pix_from_gdal(transform)
    file = f"{GRADIENT.name}_{k:02d}.npy"
    out = open_memmap(folder / file, mode="w+", dtype=np.int8, shape=(rows, cols, GRADIENT.channels))
    for top in range(0, rows, _TILE_PX):
        for left in range(0, cols, _TILE_PX):
            bottom, right = min(top + _TILE_PX, rows), min(left + _TILE_PX, cols)
            start = np.array([[1.0, 0.0, left - _MARGIN_PX], [0.0, 1.0, top - _MARGIN_PX]])
            size = (right - left + 2 * _MARGIN_PX, bottom - top + 2 * _MARGIN_PX)
            image, valid = warp_affine(pixels, compose_affine(T_map_pix, start), size)
            values = GRADIENT(image, valid)[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX]
            out[top:bottom, left:right] = np.clip(np.rint(values / _STEP), -127, 127).astype(np.int8)
            step((bottom - top) * (right - left))
    out.flush()
    middle = T_map_pix @ np.array([(cols - 1) / 2, (rows - 1) / 2, 1.0])
    gsd_m = pixel / _scale(grid.crs, float(middle[0]), float(middle[1]))
    return FeatureLevel(
        file=file,
        rows=rows,
        cols=cols,
        transform=transform,
        name=GRADIENT.name,
        channels=GRADIENT.channels,
        recipe=GRADIENT.recipe,
        step=_STEP,
        gsd_m=gsd_m,
    )


def _scale(crs: MapCrs, easting: float, northing: float) -> float:
    return crs.linearised_at_map(easting, northing).scale
