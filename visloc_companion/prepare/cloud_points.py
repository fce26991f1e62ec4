"""The points of a pack's cloud: clouds in, the highest point of each cell of the pack out, in tiles (maps/cloud_tiles.py).

First every file is folded, chunk by chunk, into one scratch file of cells, which the disk holds and not the memory: a higher
point takes its cell, so that going on after a break ends in the same. Then the cells are written tile by tile, without
wild points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import CloudError, ConfigError, DatumMissing
from visloc_companion.maps.cloud_las import LasFile, open_las
from visloc_companion.maps.cloud_tiles import POINTS_TYPE, SPACING_M, STEP_M, TILE_M, TILES_TYPE
from visloc_companion.maps.crs import MapCrs, map_crs
from visloc_companion.maps.manifest import CloudEntry
from visloc_companion.maps.stored import npy_header
from visloc_companion.maps.wild import surface_mask
from visloc_companion.prepare.cloud import on_land, stated_crs
from visloc_companion.prepare.surface import Datum, settled_datum
from visloc_companion.prepare.target import TargetGrid
from visloc_companion.prepare.work_folder import Progress, WorkFolder, reserved, stage, synced
from visloc_companion.types import FloatArray

POINTS, TILES, SCRATCH = "cloud.npy", "cloud_tiles.npy", "cloud.cells"
SIDE = round(TILE_M / SPACING_M)
"""Cells along a tile."""
CELL = np.dtype([("up", "<f4"), ("east", "<u2"), ("south", "<u2")])
"""Height, and place in the tile in steps; `east` is one more than that: what was never written is empty."""
COVER = 8
"""Cells along a square that counts as covered: 4 m."""
MIDDLE = 2**15
ORDER = np.random.default_rng(0).permutation(SIDE * SIDE)


@dataclass(frozen=True, slots=True, eq=False)
class PackCloud:
    """Which files become points, in which CRS and datum, and the tiles over the pack's grid."""

    paths: tuple[Path, ...]
    crs_text: str
    datum: Datum
    undulation_m: float | None
    grid: TargetGrid

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of tiles."""
        west, south, east, north = self.grid.bounds
        return math.ceil((north - south) / TILE_M), math.ceil((east - west) / TILE_M)

    @property
    def bytes_needed(self) -> int:
        """Most that the scratch file and the points can take."""
        return math.prod(self.shape) * SIDE * SIDE * (CELL.itemsize + 3 * POINTS_TYPE.itemsize)


def pack_cloud(
    paths: Sequence[Path], crs_text: str, grid: TargetGrid, stated: Datum | None, undulation_m: float | None
) -> PackCloud | None:
    """Open all files once and settle their datum; None without files.

    Raises CloudError for a file that cannot be read, DatumMissing for one without a CRS, or ellipsoidal without an undulation,
    and for a `crs_text` that no file takes, ConfigError for one without files.
    """
    if crs_text and not paths:
        raise ConfigError("is given without --cloud", where="--cloud-crs", remedy="name the clouds, or leave it out")
    if not paths:
        return None
    named, takes_it = [], False
    for path in paths:
        with open_las(path, crs_text) as las:
            named.append((str(path), stated_crs(las)))
            takes_it |= not las.states_crs
    if crs_text and not takes_it:
        _require_same(named, map_crs(crs_text, "--cloud-crs"))
    datum, undulation_m = settled_datum(named, stated, undulation_m)
    return PackCloud(tuple(paths), crs_text, datum, undulation_m, grid)


def _require_same(named: Sequence[tuple[str, MapCrs]], given: MapCrs) -> None:
    """Raise DatumMissing where a file that states a CRS states another one than is given: nobody knows which of them is meant."""
    for name, crs in named:
        if crs != given:
            raise DatumMissing(
                f"states {crs.name}, so that --cloud-crs ({given.name}) would not be used",
                where=name,
                remedy="leave --cloud-crs out, or put right what the file states (las2las -epsg, pdal translate)",
            )


def write_cloud(work: WorkFolder, cloud: PackCloud | None, report: Progress) -> CloudEntry | None:
    """Write the points, unless they are there, and return what the manifest says of them.

    Goes on where the work was broken off, file by file. Raises CloudError for a file without a point on the orthophoto, OSError
    where the disk is full.
    """
    known = work.result(POINTS)
    if known is not None or cloud is None:
        return None if known is None else CloudEntry.model_validate(known)
    scratch = work.path / SCRATCH
    if work.result(SCRATCH) is None:
        with scratch.open("wb") as stream:
            stream.truncate(math.prod(cloud.shape) * SIDE * SIDE * CELL.itemsize)
        reserved(scratch)
        work.record(SCRATCH, flush=partial(synced, scratch))
    for number, path in enumerate(cloud.paths):
        if work.result(f"{SCRATCH} {number}") is None:
            with open_las(path, cloud.crs_text) as las:
                _fold_file(scratch, las, cloud, stage(report, f"cloud {path.name}", las.point_count))
            work.record(f"{SCRATCH} {number}", flush=partial(synced, scratch))
    entry = _write_tiles(work.path, cloud, stage(report, "cloud tiles", math.prod(cloud.shape)))
    work.record(POINTS, entry.model_dump(mode="json"), partial(_synced_all, work.path))
    work.sync()
    scratch.unlink()
    return entry


def _fold_file(scratch: Path, las: LasFile, cloud: PackCloud, step: Callable[[int], None]) -> None:
    crs, met = stated_crs(las), 0
    for points in las.chunks():
        met += _fold(scratch, _in_map(points, crs, las.height_unit_m, cloud), cloud)
        step(len(points))
    if not met:
        raise CloudError(
            "has no point on the orthophoto", where=str(las.path), remedy="name clouds of the place, check their CRS"
        )


def _in_map(points: FloatArray, crs: MapCrs, height_unit_m: float, cloud: PackCloud) -> FloatArray:
    """(N, 3) points of a file to easting, northing of the pack and height above sea level."""
    placed = np.empty_like(points)
    placed[:, :2] = points[:, :2] if crs == cloud.grid.crs else cloud.grid.crs.to_map_array(crs.to_geo_array(points[:, :2]))
    placed[:, 2] = points[:, 2] * height_unit_m - (cloud.undulation_m or 0.0)
    return placed


def _fold(scratch: Path, points: FloatArray, cloud: PackCloud) -> int:
    """Let points (N, 3) of the map take the cells in which they are the highest; how many of them are on the map.

    The scratch file is mapped anew for every chunk: what was mapped before leaves the memory.
    """
    west, south, east, north = cloud.grid.bounds
    inside = (points[:, 0] >= west) & (points[:, 0] < east) & (points[:, 1] > south) & (points[:, 1] <= north)
    points = points[inside & on_land(points[:, 2])]
    if not len(points):
        return 0
    offsets = np.column_stack([points[:, 0] - west, north - points[:, 1]])
    tile, rest = (offsets // TILE_M).astype(np.int64), offsets % TILE_M
    cell = np.minimum((rest / SPACING_M).astype(np.int64), SIDE - 1)
    number = (tile[:, 1] * cloud.shape[1] + tile[:, 0]) * (SIDE * SIDE) + cell[:, 1] * SIDE + cell[:, 0]
    up = points[:, 2].astype(np.float32)
    order = np.lexsort((-up, number))
    top = order[np.flatnonzero(np.diff(number[order], prepend=-1))]
    cells = np.memmap(scratch, CELL, "r+")
    held = cells[number[top]]
    top = top[(held["east"] == 0) | (up[top] > held["up"])]
    steps = np.minimum((rest[top] / STEP_M).astype(np.uint16), round(TILE_M / STEP_M) - 1)
    taken = np.empty(len(top), CELL)
    taken["up"], taken["east"], taken["south"] = up[top], steps[:, 0] + 1, steps[:, 1]
    cells[number[top]] = taken
    return len(points)


def _write_tiles(folder: Path, cloud: PackCloud, step: Callable[[int], None]) -> CloudEntry:
    rows, cols = cloud.shape
    tiles = np.zeros((rows * cols + 1, 2), TILES_TYPE)
    covered = 0
    with (folder / POINTS).open("wb") as out:
        out.write(npy_header(POINTS_TYPE, (0, 3)))
        for row in range(rows):
            block = np.memmap(folder / SCRATCH, CELL, "r", row * cols * SIDE * SIDE * CELL.itemsize, (cols, SIDE * SIDE))
            for col in range(cols):
                covered += _squares(block[col])
                tiles[row * cols + col, 1] = _write_tile(out, block[col], tiles, row * cols + col)
            step(cols)
        n_points = int(tiles[-1, 0])
        if n_points == 0:
            raise CloudError("hold no point that is a surface", where=str(cloud.paths[0]), remedy="name clouds with content")
        out.seek(0)
        out.write(npy_header(POINTS_TYPE, (n_points, 3)))
    (folder / TILES).write_bytes(npy_header(TILES_TYPE, tiles.shape) + tiles.tobytes())
    west, south, east, north = cloud.grid.bounds
    return CloudEntry(
        points=POINTS,
        tiles=TILES,
        n_points=n_points,
        tile_rows=rows,
        tile_cols=cols,
        west_map_m=west,
        north_map_m=north,
        tile_m=TILE_M,
        spacing_m=SPACING_M,
        step_m=STEP_M,
        source_datum=cloud.datum,
        geoid_undulation_m=cloud.undulation_m,
        share_covered=min(1.0, covered * (COVER * SPACING_M) ** 2 / ((east - west) * (north - south))),
    )


def _write_tile(out: BinaryIO, cells: NDArray[Any], tiles: NDArray[np.int64], number: int) -> int:
    """Append a tile's points, note in `tiles` where the next one begins, and return the tile's base in steps."""
    full = cells[ORDER]
    full = full[full["east"] > 0]
    places = np.column_stack([full["east"].astype(np.float64) - 1, full["south"], full["up"] / STEP_M])
    base = 0
    if len(places):
        places = places[surface_mask(places * STEP_M)]
        base = round(float(np.median(places[:, 2]))) - MIDDLE
        places[:, 2] = np.rint(places[:, 2]) - base
        places = places[(places[:, 2] >= 0) & (places[:, 2] < 2 * MIDDLE)]
        out.write(np.ascontiguousarray(places.astype(POINTS_TYPE)).tobytes())
    tiles[number + 1, 0] = tiles[number, 0] + len(places)
    return base


def _squares(cells: NDArray[Any]) -> int:
    """Squares of COVER cells a side that hold a point."""
    count = SIDE // COVER
    known = (cells["east"] > 0).reshape(count, COVER, count, COVER)
    return int(np.count_nonzero(known.any(axis=(1, 3))))


def _synced_all(folder: Path) -> None:
    synced(folder / POINTS)
    synced(folder / TILES)
