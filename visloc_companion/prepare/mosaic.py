"""Rasters of a pack: sources resampled into one grid, block by block, and written as cloud-optimised GeoTIFF."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import RasterioError
from rasterio.windows import Window

from visloc_companion.geo.raster import apply_affine, compose_affine
from visloc_companion.maps.filled import FILL_PX, fill_reach_px
from visloc_companion.maps.filled import filled as filled_heights
from visloc_companion.maps.layer import Values
from visloc_companion.maps.places import pix_of_geo
from visloc_companion.maps.warp import warp_affine, warp_places
from visloc_companion.prepare.target import BLOCK_PX, Source, TargetGrid
from visloc_companion.types import FloatArray

SIDE_PX = 2048
Step = Callable[[int], None]
"""Called with the number of pixels that are done."""


def write_ortho(path: Path, grid: TargetGrid, sources: Sequence[Source], step: Step) -> float:
    """Mosaic of orthophotos, the first on top, with an alpha band. Returns the share of valid pixels.

    Raises MapError for damaged sources, OSError where the disk refuses what is written.
    """
    channels = max(source.layer.channels for source in sources)
    interpretation = [ColorInterp.gray] if channels == 1 else [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    n_valid = 0
    plain = path.with_suffix(".plain.tif")
    with _writing(path), rasterio.open(plain, "w", **_profile(grid, channels + 1, "uint8")) as out:
        out.colorinterp = [*interpretation, ColorInterp.alpha]
        for window, T_map_pix, size_px in blocks(grid, SIDE_PX):
            pixels, valid = merged(sources, grid, T_map_pix, size_px, channels)
            n_valid += int(valid.sum())
            bands = pixels[None] if channels == 1 else pixels.transpose(2, 0, 1)
            out.write(np.concatenate([bands, valid[None].astype(np.uint8) * np.uint8(255)]), window=window)
            step(size_px[0] * size_px[1])
    _to_cog(plain, path, grid)
    return n_valid / (grid.rows * grid.cols)


def write_heights(path: Path, grid: TargetGrid, sources: Sequence[Source], lower_m: float, step: Step) -> tuple[float, float]:
    """Surface model less `lower_m`, the first on top, small holes filled. Returns the shares of known and of filled pixels.

    Raises as `write_ortho`.
    """
    n_known = n_filled = 0
    reach_px = fill_reach_px(grid.pixel)
    plain = path.with_suffix(".plain.tif")
    with _writing(path), rasterio.open(plain, "w", nodata=np.nan, **_profile(grid, 1, "float32")) as out:
        for window, T_map_pix, size_px in blocks(grid, SIDE_PX):
            margin = np.array([[1.0, 0.0, -FILL_PX], [0.0, 1.0, -FILL_PX]])
            grown = size_px[0] + 2 * FILL_PX, size_px[1] + 2 * FILL_PX
            heights, known = merged(sources, grid, compose_affine(T_map_pix, margin), grown, 1)
            filled = filled_heights(heights.astype(np.float32), known, reach_px)
            inner = slice(FILL_PX, -FILL_PX), slice(FILL_PX, -FILL_PX)
            n_filled += int((np.isfinite(filled) & ~known)[inner].sum())
            n_known += int(np.isfinite(filled[inner]).sum())
            out.write(filled[inner] - np.float32(lower_m), 1, window=window)
            step(size_px[0] * size_px[1])
    _to_cog(plain, path, grid)
    return n_known / (grid.rows * grid.cols), n_filled / (grid.rows * grid.cols)


def blocks(grid: TargetGrid, side: int) -> Iterator[tuple[Window, FloatArray, tuple[int, int]]]:
    """Windows of a grid: raster window, (2, 3) `T_map_pix`, (width, height)."""
    for top in range(0, grid.rows, side):
        for left in range(0, grid.cols, side):
            width, height = min(side, grid.cols - left), min(side, grid.rows - top)
            shift = np.array([[1.0, 0.0, left], [0.0, 1.0, top]])
            yield Window(left, top, width, height), compose_affine(grid.T_map_pix, shift), (width, height)


def resampled(
    source: Source, grid: TargetGrid, T_map_pix: FloatArray, size_px: tuple[int, int]
) -> tuple[Values, NDArray[np.bool_]]:
    """A window of a source in the grid's CRS."""
    if source.crs == grid.crs:
        return warp_affine(source.layer, T_map_pix, size_px)

    def places(pix: FloatArray) -> FloatArray:
        return pix_of_geo(source.layer, source.crs, grid.crs.to_geo_array(apply_affine(T_map_pix, pix)))

    return warp_places(source.layer, places, size_px)


def merged(
    sources: Sequence[Source], grid: TargetGrid, T_map_pix: FloatArray, size_px: tuple[int, int], channels: int
) -> tuple[Values, NDArray[np.bool_]]:
    """A window of several sources in the grid's CRS, the first on top."""
    shape = (size_px[1], size_px[0])
    dtype = sources[0].layer.dtype
    merged: Values = np.zeros(shape if channels == 1 else (*shape, channels), dtype)
    valid = np.zeros(shape, np.bool_)
    for source in sources:
        if valid.all():
            break
        values, known = resampled(source, grid, T_map_pix, size_px)
        if values.ndim < merged.ndim:
            values = np.repeat(values[..., None], channels, axis=2)
        use = known & ~valid
        merged[use] = values[use]
        valid |= known
    return merged, valid


def _profile(grid: TargetGrid, count: int, dtype: str) -> dict[str, Any]:
    return {
        "driver": "GTiff",
        "width": grid.cols,
        "height": grid.rows,
        "count": count,
        "dtype": dtype,
        "crs": grid.crs.wkt,
        "transform": rasterio.Affine(*grid.transform),
        "tiled": True,
        "blockxsize": BLOCK_PX,
        "blockysize": BLOCK_PX,
        "bigtiff": "IF_SAFER",
    }


def _to_cog(plain: Path, path: Path, grid: TargetGrid) -> None:
    """Uncompressed, so that a window costs no decoding; overviews by averaging, which weighs with alpha."""
    with _writing(path):
        rasterio.shutil.copy(
            plain,
            path,
            driver="COG",
            COMPRESS="NONE",
            BLOCKSIZE=BLOCK_PX,
            **({"OVERVIEWS": "IGNORE_EXISTING", "OVERVIEW_COUNT": grid.overviews} if grid.overviews else {"OVERVIEWS": "NONE"}),
            OVERVIEW_RESAMPLING="AVERAGE",
            BIGTIFF="IF_SAFER",
        )
    plain.unlink()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """What GDAL raises where it cannot write as an OSError: its own exceptions have no public base in rasterio, and where it
    names no reason rasterio gives SystemError."""
    try:
        yield
    except Exception as why:
        if not isinstance(why, (RasterioError, SystemError)) and not type(why).__name__.startswith("CPLE_"):
            raise
        said = why.__cause__ or why  # rasterio says "see previous exception"
        raise OSError(errno.EIO, str(said), str(path)) from why
