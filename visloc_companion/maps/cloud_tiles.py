"""Points of a pack's cloud: the highest of each cell of SPACING_M, in tiles of TILE_M that a search reads a few of.

`points` (N, 3) uint16 are steps of STEP_M east and south of the tile's north-west corner, and above the tile's base. They lie
tile by tile, within a tile in a fixed random order of the cells: the first part of a tile is a thinned tile. `tiles` (T + 1, 2)
int64 are the first point of each tile and its base, in steps above mean sea level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import MapError
from visloc_companion.maps.manifest import REBUILD, CloudEntry
from visloc_companion.maps.stored import mapped_array
from visloc_companion.types import FloatArray

TILE_M = 64.0
SPACING_M = 0.25
"""Laser clouds of 13 to 14 points a square metre keep 8 to 9.5, as many as registration was fitted on. With cells of 0.5 m they
kept 3.6 to 3.8, and a plantation's surface, taken from so few, came out 6 m high."""
STEP_M = 0.01
POINTS_TYPE = np.dtype("<u2")
TILES_TYPE = np.dtype("<i8")


@dataclass(frozen=True, slots=True, eq=False)
class StoredCloud:
    """A cloud, memory-mapped: see the module."""

    entry: CloudEntry
    points: NDArray[np.uint16]
    first: NDArray[np.int64]
    base: NDArray[np.int64]

    def within(self, center_map_m: tuple[float, float], radius_map_m: float, max_points: int) -> FloatArray:
        """(N, 3) easting, northing, height above mean sea level of the points in a circle; at most so many, thinned evenly."""
        tiles = self._touched(center_map_m, radius_map_m)
        count = int((self.first[tiles + 1] - self.first[tiles]).sum())
        share = min(1.0, max_points / max(1, count))
        parts = [self._tile(int(tile), share) for tile in tiles]
        points = np.concatenate(parts) if parts else np.zeros((0, 3))
        away = np.hypot(points[:, 0] - center_map_m[0], points[:, 1] - center_map_m[1])
        return points[away <= radius_map_m]

    def _touched(self, center_map_m: tuple[float, float], radius_map_m: float) -> NDArray[np.int64]:
        """Numbers of the tiles that the circle's square touches."""
        entry = self.entry
        east, south = center_map_m[0] - entry.west_map_m, entry.north_map_m - center_map_m[1]
        cols, rows = (
            np.arange(
                max(0, math.floor((middle - radius_map_m) / entry.tile_m)),
                min(count, math.floor((middle + radius_map_m) / entry.tile_m) + 1),
            )
            for middle, count in ((east, entry.tile_cols), (south, entry.tile_rows))
        )
        return np.asarray((rows[:, None] * entry.tile_cols + cols).ravel(), np.int64)

    def _tile(self, tile: int, share: float) -> FloatArray:
        entry, start = self.entry, int(self.first[tile])
        count = math.floor((int(self.first[tile + 1]) - start) * share)
        row, col = divmod(tile, entry.tile_cols)
        steps = self.points[start : start + count].astype(np.float64)
        points = np.empty_like(steps)
        points[:, 0] = entry.west_map_m + col * entry.tile_m + (steps[:, 0] + 0.5) * entry.step_m
        points[:, 1] = entry.north_map_m - row * entry.tile_m - (steps[:, 1] + 0.5) * entry.step_m
        points[:, 2] = (steps[:, 2] + float(self.base[tile])) * entry.step_m
        return points


def open_cloud(folder: Path, entry: CloudEntry) -> StoredCloud:
    """Map the files of a cloud. Raises MapError where they are not those that the manifest says, or do not fit each other."""
    count = entry.tile_rows * entry.tile_cols
    points = mapped_array(folder / entry.points, POINTS_TYPE, (entry.n_points, 3))
    tiles = np.array(mapped_array(folder / entry.tiles, TILES_TYPE, (count + 1, 2)))
    first, base = tiles[:, 0], tiles[:count, 1]
    if first[0] != 0 or first[-1] != entry.n_points or (np.diff(first) < 0).any():
        raise MapError("does not divide the points into tiles", where=str(folder / entry.tiles), remedy=REBUILD)
    return StoredCloud(entry, points, first, base)
