"""Features of the map, computed once: for each function one file a GSD, a factor of the square root of 2 apart."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from visloc_companion.errors import MapError, ModelError
from visloc_companion.geo.raster import T_map_pix_from_gdal, compose_affine
from visloc_companion.localise.features.base import Features, without_margin
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.geotiff import DatasetLayer, open_ortho
from visloc_companion.maps.layer import Layer, level_shapes
from visloc_companion.maps.manifest import FeatureLevel
from visloc_companion.maps.stored import LEVEL_RATIO, NEAR_OCTAVES, STEPS, TILE_PX, quantised, tiled_shape
from visloc_companion.maps.warp import warp_affine
from visloc_companion.prepare.dates import DatedSource, mean_features
from visloc_companion.prepare.mosaic import Step
from visloc_companion.prepare.target import TargetGrid
from visloc_companion.prepare.work_folder import Progress, WorkFolder, reserved, stage

SMALLEST_PX = 48
BLOCK_PX = 4 * TILE_PX
"""Side of what is computed, and gone on with, at a time."""


@dataclass(frozen=True, slots=True)
class LevelGrid:
    """One level of a map: its number, its pixel in map units, and (rows, cols)."""

    number: int
    pixel: float
    rows: int
    cols: int


def level_grids(grid: TargetGrid, finest: float = 0.0) -> tuple[LevelGrid, ...]:
    """Levels from the map's own pixel on, without those that serve only GSDs below `finest` (the coarsest is always there)."""
    levels: list[LevelGrid] = []
    while True:
        factor = LEVEL_RATIO ** len(levels)
        rows, cols = int(grid.rows / factor), int(grid.cols / factor)
        if levels and min(rows, cols) < SMALLEST_PX:
            break
        levels.append(LevelGrid(len(levels), grid.pixel * factor, rows, cols))
    lowest = finest * 2**-NEAR_OCTAVES
    return tuple(level for level in levels if level.pixel >= lowest) or (levels[-1],)


def wanted_levels(grid: TargetGrid, features: Features, finest_gsd_m: float) -> tuple[LevelGrid, ...]:
    """All levels for the gradient, which takes little space; those from a GSD on for the others."""
    return level_grids(grid, 0.0 if features.name == GRADIENT.name else finest_gsd_m)


def pixels_of(levels: Sequence[LevelGrid]) -> int:
    """Pixels of some levels."""
    return sum(level.rows * level.cols for level in levels)


def stored_bytes(levels: Sequence[LevelGrid], features: Features) -> int:
    """Space that some levels take, whole tiles counted."""
    return sum(prod(tiled_shape(level.rows, level.cols, features.channels)) for level in levels)


def check_names(features: Sequence[Features]) -> None:
    """Names become names of files and must differ. Raises ModelError."""
    names = [each.name for each in features]
    for name in names:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
            raise ModelError(f"name {name!r} cannot name a file", remedy="name the model with letters, digits, '-', '_' and '.'")
        if names.count(name) > 1:
            raise ModelError(f"two functions are named {name!r}", remedy="give each model once")


def feature_levels(
    work: WorkFolder,
    grid: TargetGrid,
    ortho: Path,
    functions: Sequence[Features],
    finest_gsd_m: float,
    report: Progress,
    dates: Sequence[DatedSource] = (),
) -> tuple[FeatureLevel, ...]:
    """Write the features of all functions, computed from the pack's own orthophoto and those of other dates that are fine enough,
    and return what the manifest says of them.

    Goes on where the work was broken off. Raises MapError where a file cannot be written, OSError where the disk is full.
    """
    pixels = DatasetLayer(open_ortho(ortho), level_shapes(grid.rows, grid.cols))
    found: list[FeatureLevel] = []
    for each in functions:
        levels = wanted_levels(grid, each, finest_gsd_m)
        step = stage(report, f"features {each.name}", pixels_of(levels))
        found.extend(_write_level(work, level, grid, each, pixels, dates, step) for level in levels)
    return tuple(found)


def _write_level(
    work: WorkFolder,
    level: LevelGrid,
    grid: TargetGrid,
    features: Features,
    pixels: Layer,
    dates: Sequence[DatedSource],
    step: Step,
) -> FeatureLevel:
    transform = (level.pixel, 0.0, grid.west, 0.0, -level.pixel, grid.north)
    T_map_pix = T_map_pix_from_gdal(transform)
    gsd_m = level.pixel / _scale_at_middle(grid, level, T_map_pix)
    serving = [date for date in dates if date.serves(gsd_m)]
    entry = FeatureLevel(
        file=f"{features.name}_{level.number:02d}.npy",
        rows=level.rows,
        cols=level.cols,
        transform=transform,
        name=features.name,
        recipe=features.recipe,
        channels=features.channels,
        oriented=features.oriented,
        step=features.bound / STEPS,
        gsd_m=gsd_m,
        tile_px=TILE_PX,
        n_dates=1 + len(serving),
    )
    out = _opened(work, entry)
    flush = out.flush
    for number, (top, left, bottom, right) in enumerate(_blocks(level)):
        part = f"{entry.file} {number}"
        if work.result(part) is None:
            origin = compose_affine(T_map_pix, np.array([[1.0, 0.0, left], [0.0, 1.0, top]]))
            size_px = right - left, bottom - top
            _put(out, top, left, _block(features, pixels, grid, serving, origin, size_px, entry.step))
            work.record(part, flush=flush)
        step((bottom - top) * (right - left))
    return entry


def _opened(work: WorkFolder, entry: FeatureLevel) -> np.memmap[Any, np.dtype[np.int8]]:
    """The file's array, made where it was not begun yet."""
    path, part = work.path / entry.file, f"{entry.file} begun"
    shape = tiled_shape(entry.rows, entry.cols, entry.channels, entry.tile_px)
    if work.result(part) is not None:
        return _memmap(path, "r+", None)
    out = _memmap(path, "w+", shape)
    reserved(path)
    work.record(part, flush=out.flush)
    return out


def _memmap(path: Path, mode: str, shape: tuple[int, ...] | None) -> np.memmap[Any, np.dtype[np.int8]]:
    try:
        return open_memmap(path, mode=mode, dtype=np.int8 if shape else None, shape=shape)
    except ValueError as why:
        raise MapError(f"is no array any more: {why}", where=str(path), remedy="check the disk, then build again") from why


def _block(
    features: Features,
    pixels: Layer,
    grid: TargetGrid,
    dates: Sequence[DatedSource],
    T_map_pix: NDArray[np.float64],
    size_px: tuple[int, int],
    step: float,
) -> NDArray[np.int8]:
    """(H, W, C) stored values of a (width, height) block, computed with as much of its surroundings as the features see."""
    margin = features.context_px
    start = compose_affine(T_map_pix, np.array([[1.0, 0.0, -margin], [0.0, 1.0, -margin]]))
    grown = size_px[0] + 2 * margin, size_px[1] + 2 * margin
    image, valid = warp_affine(pixels, start, grown)
    inner = without_margin(valid, margin)
    if not inner.any():
        values = np.zeros((size_px[1], size_px[0], features.channels), np.float32)
    else:
        values = mean_features(features, (image, valid), (date.window(grid, start, grown) for date in dates), margin)
    return quantised(values, inner, step)


def _put(out: NDArray[np.int8], top: int, left: int, block: NDArray[np.int8]) -> None:
    """Put a block that starts at whole tiles into the tiles."""
    for row in range(0, block.shape[0], TILE_PX):
        for col in range(0, block.shape[1], TILE_PX):
            part = block[row : row + TILE_PX, col : col + TILE_PX]
            out[(top + row) // TILE_PX, (left + col) // TILE_PX, : part.shape[0], : part.shape[1]] = part


def _blocks(level: LevelGrid) -> Iterator[tuple[int, int, int, int]]:
    """(top, left, bottom, right) of the blocks of a level."""
    for top in range(0, level.rows, BLOCK_PX):
        for left in range(0, level.cols, BLOCK_PX):
            yield top, left, min(top + BLOCK_PX, level.rows), min(left + BLOCK_PX, level.cols)


def _scale_at_middle(grid: TargetGrid, level: LevelGrid, T_map_pix: NDArray[np.float64]) -> float:
    middle = T_map_pix @ np.array([(level.cols - 1) / 2, (level.rows - 1) / 2, 1.0])
    return grid.crs.linearised_at_map(float(middle[0]), float(middle[1])).scale
