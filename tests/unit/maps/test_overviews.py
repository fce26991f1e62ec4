"""Large files are read by their overviews, where these show the ground where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import Resampling

from visloc_companion.maps.geotiff import DatasetLayer, layer_of, open_dsm, open_ortho
from visloc_companion.maps.layer import Layer

NORTH = ("EPSG:32632", (48.2, 10.4))
SIDE = 768
V, U = np.mgrid[:SIDE, :SIDE]
PICTURE = (128 + 60 * np.sin(U / 5) * np.cos(V / 7) + 20 * np.sin(U / 2)).astype(np.uint8)
HOLE = U + V < 300
AVERAGES = [Resampling.average, Resampling.cubic, Resampling.bilinear]


def with_overviews(path: Path, how: Resampling) -> Path:
    with rasterio.open(path, "r+") as out:
        out.build_overviews([2, 4, 8], how)
    return path


def level(layer: Layer, k: int) -> np.ndarray:
    rows, cols = layer.shapes[k]
    values, valid = layer.read(k, (0, rows), (0, cols))
    return np.where(valid > 0, values.astype(np.float64), np.nan)


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("profile", [{}, {"nodata": 0}, {"compress": "jpeg"}], ids=["plain", "nodata", "jpeg"])
def test_overviews_of_nearest_pixels_are_not_used(tmp_path: Path, write_raster, profile: dict[str, object], k: int) -> None:
    """gdaladdo makes them by default: half a pixel of theirs beside the place, up to 0.4 px of the pack."""
    picture = np.where(HOLE, 0, PICTURE) if "nodata" in profile else PICTURE
    write_raster(tmp_path / "a.tif", picture, *NORTH, 0.2, tiled=True, **profile)
    whole = layer_of(open_ortho(tmp_path / "a.tif"))
    layer = layer_of(open_ortho(with_overviews(tmp_path / "a.tif", Resampling.nearest)), in_memory_bytes=0)
    assert isinstance(layer, DatasetLayer) and not layer.by_overviews
    np.testing.assert_allclose(level(layer, k), level(whole, k), atol=2.0)


@pytest.mark.parametrize("how", AVERAGES, ids=lambda how: how.name)
def test_overviews_that_show_the_ground_where_it_is_are_used(tmp_path: Path, write_raster, how: Resampling) -> None:
    write_raster(tmp_path / "a.tif", PICTURE, *NORTH, 0.2, tiled=True)
    layer = layer_of(open_ortho(with_overviews(tmp_path / "a.tif", how)), in_memory_bytes=0)
    assert isinstance(layer, DatasetLayer) and layer.by_overviews


@pytest.mark.parametrize("how", [Resampling.nearest, Resampling.average], ids=lambda how: how.name)
def test_heights_are_read_where_they_are(tmp_path: Path, write_raster, how: Resampling) -> None:
    """A slope of 45 degrees: heights half a pixel of the overview aside are off by as much."""
    heights = np.where(HOLE, -9999, 400 + 0.2 * U + 0.2 * V).astype(np.float32)
    write_raster(tmp_path / "dsm.tif", heights, *NORTH, 0.2, tiled=True, nodata=-9999)
    whole = layer_of(open_dsm(tmp_path / "dsm.tif"))
    layer = layer_of(open_dsm(with_overviews(tmp_path / "dsm.tif", how)), in_memory_bytes=0)
    off = np.abs(level(layer, 2) - level(whole, 2))
    assert np.nanquantile(off, 0.99) < 0.01


def test_a_file_of_one_tone_tells_nothing(tmp_path: Path, write_raster) -> None:
    write_raster(tmp_path / "a.tif", np.full((SIDE, SIDE), 90, np.uint8), *NORTH, 0.2, tiled=True)
    layer = layer_of(open_ortho(with_overviews(tmp_path / "a.tif", Resampling.nearest)), in_memory_bytes=0)
    assert isinstance(layer, DatasetLayer) and layer.by_overviews
