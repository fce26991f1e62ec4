"""Dark ground that has the nodata value is told of, and what is empty as areas is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.maps.geotiff import layer_of, open_ortho
from visloc_companion.prepare.build import build_pack

UTM, PLACE = "EPSG:32632", (48.2, 10.4)
SIDE = 700
RNG = np.random.default_rng(5)
V, U = np.mgrid[:SIDE, :SIDE]
LAND = RNG.integers(60, 200, (SIDE, SIDE, 3)).astype(np.uint8)
DARK = RNG.random((SIDE, SIDE)) < 0.003
"""Single pixels, and a few beside each other, away from the corner."""
CORNER = U + V < 300
DARK &= U + V > 310  # what touches the corner is part of it


def black(where: np.ndarray) -> np.ndarray:
    return np.where(where[..., None], 0, LAND).astype(np.uint8)


def told(tmp_path: Path, path: Path) -> list[str]:
    said: list[str] = []
    build_pack([path], None, tmp_path / "pack", warn=said.append)
    return said


@pytest.mark.parametrize("colours", [1, 3])
def test_dark_ground_of_the_nodata_value_is_told(tmp_path: Path, write_raster, colours: int) -> None:
    path = tmp_path / "dark.tif"
    write_raster(path, black(CORNER | DARK)[..., :colours], UTM, PLACE, 0.5, nodata=0)
    (words,) = told(tmp_path, path)
    missing = f"{(CORNER | DARK).mean():.1%}"
    assert words.startswith(f"{path} lacks {missing} of its pixels, 0.3% in specks where the ground has its nodata value 0")
    lost = float(words.split("features lose ")[1].split("%")[0])
    assert lost == pytest.approx(100 * (1 - 0.997**49), abs=0.8)
    assert "gdal_edit.py -unsetnodata FILE" in words
    with rasterio.open(path, "r+") as edited:
        edited.nodata = None
    assert not told(tmp_path, path)
    layer = layer_of(open_ortho(path))
    np.testing.assert_array_equal(layer.read(0, (0, SIDE), (0, SIDE))[1] > 0, ~CORNER)


def test_areas_and_their_ragged_rims_are_no_specks(tmp_path: Path, write_raster) -> None:
    ragged = CORNER | ((U + V < 310) & (RNG.random((SIDE, SIDE)) < 0.5)) | ((U > 500) & (V > 500) & (V < 540))
    path = tmp_path / "areas.tif"
    write_raster(path, black(ragged), UTM, PLACE, 0.5, nodata=0)
    assert not told(tmp_path, path)


def test_pixels_that_are_dark_in_some_bands_are_shown(tmp_path: Path, write_raster) -> None:
    land = LAND.copy()
    land[DARK, 0] = 0
    land[DARK, 2] = 0
    write_raster(tmp_path / "a.tif", land, UTM, PLACE, 0.5, nodata=0)
    assert not told(tmp_path, tmp_path / "a.tif")
    assert layer_of(open_ortho(tmp_path / "a.tif")).read(0, (0, SIDE), (0, SIDE))[1].all()


def test_a_mask_counts_before_the_nodata_value(tmp_path: Path, write_raster) -> None:
    path = tmp_path / "masked.tif"
    write_raster(path, black(CORNER | DARK), UTM, PLACE, 0.5, nodata=0)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as edited:
        edited.write_mask(~CORNER)
    np.testing.assert_array_equal(layer_of(open_ortho(path)).read(0, (0, SIDE), (0, SIDE))[1] > 0, ~CORNER)
    assert not told(tmp_path, path)
