"""Orthophotos to train on: 8-bit bands, where they show land, and whether two of them lie on one grid."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from visloc_companion.errors import CasesError
from visloc_companion.maps.collar import collar
from visloc_companion.maps.from_white import as_shown
from visloc_companion.maps.shown import shown_by

Bands = NDArray[np.uint8]
SUFFIXES = (".tif", ".tiff")
MOST_BANDS = 4
SAME_PLACE_PX = 0.1
"""Corners that differ by less are those of one grid."""
RESAMPLE = "resample the dates to one grid: gdalwarp -t_srs EPSG:CODE -te ... -tr ... IN.tif OUT.tif"


@dataclass(frozen=True, slots=True, eq=False)
class Imagery:
    """An orthophoto: `bands` (H, W, K) uint8 without alpha, K up to 4, `valid` (H, W) where it shows land.

    `crs` is None where the file states none; `T_map_px` (2, 3) takes the outer corners of pixels (column, row) to it.
    """

    path: Path
    bands: Bands
    valid: NDArray[np.bool_]
    crs: Any
    T_map_px: NDArray[np.float64]


def geotiffs_in(folder: Path) -> list[Path]:
    """The GeoTIFFs of a folder (.tif, .tiff, in any case), by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())


def read_imagery(path: Path) -> Imagery:
    """Read an orthophoto whole. Raises CasesError for one that cannot be read, or has a colour table or more than 8 bits.

    Where the file does not say where it is empty, black or white that reaches in from the border is empty (maps/collar.py).
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            return _read(path, dataset)
    except rasterio.errors.RasterioError as why:
        raise CasesError(f"cannot be read: {why}", where=str(path), remedy="name a whole GeoTIFF") from why


def _read(path: Path, dataset: Any) -> Imagery:
    meanings = tuple(dataset.colorinterp)
    _require_8_bits(path, dataset.dtypes, meanings)
    shown = shown_by(dataset, meanings)
    empty = ColorInterp.alpha if shown.is_stated else None
    used = [band for band, meaning in zip(dataset.indexes, meanings, strict=True) if meaning is not empty]
    bands = np.ascontiguousarray(dataset.read(used[:MOST_BANDS]).transpose(1, 2, 0))
    valid = shown.read(dataset, bands.shape[:2])
    bands = as_shown(dataset, bands)
    a, b, c, d, e, f = tuple(dataset.transform)[:6]
    image = Imagery(path, bands, valid, dataset.crs, np.array([[a, b, c], [d, e, f]]))
    return image if shown.tells(valid) else replace(image, valid=~collar(colours(image)))


def colours(image: Imagery) -> Bands:
    """(H, W, 3) the first three bands, or (H, W) the first where there are fewer."""
    return np.ascontiguousarray(image.bands[..., :3] if image.bands.shape[2] >= 3 else image.bands[..., 0])


def _require_8_bits(path: Path, dtypes: tuple[str, ...], meanings: tuple[ColorInterp, ...]) -> None:
    if ColorInterp.palette in meanings:
        raise CasesError("has a colour table", where=str(path), remedy="expand it: gdal_translate -expand rgb IN.tif OUT.tif")
    if other := [dtype for dtype in dtypes if dtype != "uint8"]:
        raise CasesError(
            f"holds {other[0]} values, 8-bit ones (uint8) are trained on",
            where=str(path),
            remedy="convert it: gdal_translate -ot Byte -scale LOW HIGH 0 255 IN.tif OUT.tif, with the range of its values",
        )


def require_same_size(first: Imagery, other: Imagery) -> None:
    """Raises CasesError for two images of different numbers of rows or columns, or with pixels of different size."""
    if first.valid.shape != other.valid.shape:
        (rows, cols), (first_rows, first_cols) = other.valid.shape, first.valid.shape
        raise _unlike(first, other, f"it has {cols} x {rows} px instead of {first_cols} x {first_rows}")
    sides, first_sides = (np.hypot(*image.T_map_px[:, :2]) for image in (other, first))
    if not np.allclose(sides, first_sides, rtol=SAME_PLACE_PX / max(first.valid.shape), atol=0):
        raise _unlike(first, other, f"its pixels have {sides[0]:.9g} units instead of {first_sides[0]:.9g}")


def require_same_grid(first: Imagery, other: Imagery) -> None:
    """Raises CasesError for two images that do not show the same ground in the same pixel."""
    require_same_size(first, other)
    if first.crs != other.crs:
        raise _unlike(first, other, f"it is in {other.crs or 'no CRS'} instead of {first.crs or 'no CRS'}")
    rows, cols = first.valid.shape
    corners_px = np.array([[0, cols, 0, cols], [0, 0, rows, rows], [1, 1, 1, 1]], dtype=np.float64)
    off_px = np.linalg.inv(first.T_map_px[:, :2]) @ (other.T_map_px - first.T_map_px) @ corners_px
    worst_px = float(np.hypot(*off_px).max())
    if not worst_px <= SAME_PLACE_PX:
        raise _unlike(first, other, f"its corners are off by up to {worst_px:.4g} px")


def _unlike(first: Imagery, other: Imagery, why: str) -> CasesError:
    return CasesError(f"does not lie on the grid of {first.path.name}: {why}", where=str(other.path), remedy=RESAMPLE)
