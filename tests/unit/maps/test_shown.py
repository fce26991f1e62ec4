"""Files that say twice where they are empty, or say it of more bands than are used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.errors import MapError
from visloc_companion.maps.geotiff import layer_of, open_dsm, open_ortho, require_heights, stretches_of
from visloc_companion.maps.layer import Layer
from visloc_companion.train.imagery import read_imagery

NORTH = ("EPSG:32632", (48.2, 10.4))
SIDE = 128
V, U = np.mgrid[:SIDE, :SIDE]
HOLE = U + V < 60
LAKE = (U > 80) & (V > 60)
GREY = (90 + 60 * np.sin(U / 5) * np.cos(V / 7)).astype(np.uint8)
RGB = np.dstack([GREY, GREY + 9, GREY + 17])
ALPHA = np.where(HOLE, 0, 255).astype(np.uint8)


@pytest.fixture
def orthophoto(tmp_path: Path, write_raster) -> Callable[..., Path]:
    def write(bands: np.ndarray, **profile: object) -> Path:
        write_raster(tmp_path / "a.tif", bands, *NORTH, 1.0, **profile)
        return tmp_path / "a.tif"

    return write


def shown(layer: Layer, level: int = 0) -> np.ndarray:
    """Where a layer shows something, at a level."""
    rows, cols = layer.shapes[level]
    return layer.read(level, (0, rows), (0, cols))[1] > 0


@pytest.mark.parametrize("fill", [0, 255])
@pytest.mark.parametrize("nodata", [0, 255])
@pytest.mark.parametrize("colours", [GREY[..., None], RGB], ids=["grey", "colour"])
def test_alpha_hides_what_it_hides_beside_a_nodata_value(orthophoto, colours: np.ndarray, nodata: int, fill: int) -> None:
    """rasterio takes alpha's own nodata mask: of 255 it would show what alpha hides, and hide the land."""
    bands = np.dstack([np.where(HOLE[..., None], fill, colours).astype(np.uint8), ALPHA])
    path = orthophoto(bands, nodata=nodata, alpha="yes", photometric="RGB" if colours.shape[2] == 3 else "MINISBLACK")
    np.testing.assert_array_equal(shown(layer_of(open_ortho(path))), ~HOLE)
    np.testing.assert_array_equal(read_imagery(path).valid, ~HOLE)


@pytest.mark.parametrize("fill", [0, 255])
@pytest.mark.parametrize("scale", [1, 40], ids=["8 bits", "16 bits"])
def test_alpha_that_hides_nothing_says_nothing_of_the_fill(orthophoto, fill: int, scale: int) -> None:
    """Tiles of JPEG (MBTiles) and map views saved with their background are opaque to their corners."""
    full = np.iinfo(np.uint16 if scale > 1 else np.uint8).max
    rgb = np.where(HOLE[..., None], full if fill else 0, RGB.astype(np.uint16) * scale)
    path = orthophoto(
        np.dstack([rgb, np.full_like(rgb[..., 0], full)]).astype(np.uint16 if scale > 1 else np.uint8),
        alpha="yes",
        photometric="RGB",
    )
    np.testing.assert_array_equal(shown(layer_of(open_ortho(path))), ~HOLE)
    if scale == 1:
        np.testing.assert_array_equal(read_imagery(path).valid, ~HOLE)


def test_large_files_average_what_alpha_shows_alone(orthophoto) -> None:
    """A white fill that alpha hides, where zero is the nodata value, is no part of the averages at its border."""
    path = orthophoto(np.dstack([np.where(HOLE[..., None], 255, RGB), ALPHA]), nodata=0, alpha="yes", photometric="RGB")
    whole, lazy = layer_of(open_ortho(path)), layer_of(open_ortho(path), in_memory_bytes=0)
    rows, cols = whole.shapes[1]
    for got, want in zip(lazy.read(1, (0, rows), (0, cols)), whole.read(1, (0, rows), (0, cols)), strict=True):
        np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize("marked", ["no", "yes"], ids=["near infrared", "called alpha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_water_without_infrared_is_land_with_colours(orthophoto, dtype: type, marked: str) -> None:
    infrared = np.where(LAKE, 0, 255 - GREY)
    bands = np.where(HOLE[..., None], 0, np.dstack([RGB, infrared])).astype(dtype) * dtype(1 if dtype == np.uint8 else 40)
    path = orthophoto(bands, nodata=0, alpha=marked, photometric="RGB")
    np.testing.assert_array_equal(shown(layer_of(open_ortho(path, stretches_of([path])))), ~HOLE)


@pytest.mark.parametrize("fill", [0.0, -999.0, 9999.0])
def test_a_second_band_fills_no_hole_of_the_heights(orthophoto, fill: float) -> None:
    """Such as the number of points, or their spread: rasterio's mask is that of any band."""
    heights = np.where(HOLE, fill, 430 + 6 * np.sin(U / 40))
    tiff = open_dsm(orthophoto(np.dstack([heights, np.full_like(heights, 3)]).astype(np.float32), nodata=fill))
    require_heights(tiff)
    np.testing.assert_array_equal(shown(layer_of(tiff)), ~HOLE)


def test_heights_that_alpha_hides_are_unknown_beside_a_nodata_value(orthophoto) -> None:
    heights = np.where(HOLE, 0, 430 + 6 * np.sin(U / 40))
    path = orthophoto(np.dstack([heights, ALPHA]).astype(np.float32), nodata=-9999, alpha="yes")
    np.testing.assert_array_equal(shown(layer_of(open_dsm(path))), ~HOLE)


def test_a_mask_alone_is_no_orthophoto(orthophoto) -> None:
    path = orthophoto(ALPHA)
    path.with_name("a.tif.aux.xml").write_text(
        '<PAMDataset><PAMRasterBand band="1"><ColorInterp>Alpha</ColorInterp></PAMRasterBand></PAMDataset>'
    )
    with pytest.raises(MapError, match=r"a\.tif: holds no band of colours but alpha; remedy: name an orthophoto"):
        open_ortho(path)
