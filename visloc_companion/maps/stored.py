"""Features of a pack: one file for each function and GSD, int8, in tiles that a window reads as few pages as it can of.

A file is a .npy array (tile rows, tile columns, TILE_PX, TILE_PX, channels). A stored value is the feature divided by `step`;
the first channel is INVALID where the map has no content, so that a window needs no pixels to know it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import dtype_to_descr, write_array_header_1_0
from numpy.typing import NDArray

from visloc_companion.errors import MapError
from visloc_companion.geo.raster import T_map_pix_from_gdal
from visloc_companion.maps.manifest import REBUILD, FeatureLevel
from visloc_companion.types import FloatArray

LEVEL_RATIO = math.sqrt(2)
"""Between the GSDs of two levels: any wanted one is within a factor 2^0.25 of a stored one."""
NEAR_OCTAVES = 0.27
"""A level is used for GSDs this near, in powers of 2: the quarter, and what the CRS's scale and rounding add."""
STEPS = 127
"""Stored values run from -STEPS to STEPS."""
INVALID = -128
TILE_PX = 256


@dataclass(frozen=True, slots=True, eq=False)
class StoredFeatures:
    """Features of one GSD, memory-mapped: (tile rows, tile columns, tile, tile, channels) int8."""

    level: FeatureLevel
    T_map_pix: FloatArray
    tiles: NDArray[np.int8]

    @property
    def pixel_map(self) -> float:
        """Side of a pixel in map units."""
        return abs(float(self.T_map_pix[0, 0]))

    def window(self, shift: tuple[int, int], size_px: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """(height, width, channels) values from column and row `shift`, and where there are any (zero elsewhere)."""
        level, side = self.level, self.level.tile_px
        raw = np.zeros((size_px[1], size_px[0], level.channels), np.int8)
        raw[..., 0] = INVALID
        left, top = max(0, shift[0]), max(0, shift[1])
        right, bottom = min(level.cols, shift[0] + size_px[0]), min(level.rows, shift[1] + size_px[1])
        if right > left and bottom > top:
            for row, v0, v1 in _spans(top, bottom, side):
                for col, u0, u1 in _spans(left, right, side):
                    part = self.tiles[row, col, v0 - row * side : v1 - row * side, u0 - col * side : u1 - col * side]
                    raw[v0 - shift[1] : v1 - shift[1], u0 - shift[0] : u1 - shift[0]] = part
        valid = raw[..., 0] != INVALID
        if not valid.all():
            raw[~valid] = 0
        return np.multiply(raw, np.float32(level.step), dtype=np.float32), valid


def quantised(values: NDArray[np.float32], valid: NDArray[np.bool_], step: float) -> NDArray[np.int8]:
    """(H, W, C) int8 as it is stored: rounded, with a mark where `valid` (H, W) is not."""
    stored: NDArray[np.int8] = np.clip(np.rint(values / np.float32(step)), -STEPS, STEPS).astype(np.int8)
    stored[~valid] = 0
    stored[~valid, 0] = INVALID
    return stored


def tiled_shape(rows: int, cols: int, channels: int, tile_px: int = TILE_PX) -> tuple[int, int, int, int, int]:
    """Shape of the file's array."""
    return -(-rows // tile_px), -(-cols // tile_px), tile_px, tile_px, channels


def open_stored(folder: Path, level: FeatureLevel) -> StoredFeatures:
    """Map a file. Raises MapError where it is not the array that the manifest says."""
    shape = tiled_shape(level.rows, level.cols, level.channels, level.tile_px)
    tiles = mapped_array(folder / level.file, np.dtype(np.int8), shape)
    return StoredFeatures(level, T_map_pix_from_gdal(level.transform), tiles)


def mapped_array(path: Path, kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Map a .npy file read-only. Its header is compared, not parsed: numpy's reader evaluates it, and fails in many ways.

    Raises MapError where it is another array.
    """
    want = npy_header(kind, shape)
    with path.open("rb") as stream:
        got = stream.read(len(want))
    if got != want or path.stat().st_size != len(want) + math.prod(shape) * kind.itemsize:
        raise MapError(f"is not the array of {kind} {shape} that the manifest says", where=str(path), remedy=REBUILD)
    return np.memmap(path, dtype=kind, mode="r", offset=len(want), shape=shape)


def npy_header(kind: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """The header of a .npy file, as numpy writes it; its length does not depend on the number of rows."""
    header = BytesIO()
    write_array_header_1_0(header, {"descr": dtype_to_descr(kind), "fortran_order": False, "shape": shape})
    return header.getvalue()


def _spans(first: int, last: int, side: int) -> list[tuple[int, int, int]]:
    """(tile, first, last) of the tiles that first:last touches."""
    return [(k, max(first, k * side), min(last, (k + 1) * side)) for k in range(first // side, (last - 1) // side + 1)]
