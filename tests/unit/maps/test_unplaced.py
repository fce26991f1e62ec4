"""Rasters that do not say where they lie: the command that is named must be one that works."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from rasterio.crs import CRS

from visloc_companion.errors import DatumMissing, MapError
from visloc_companion.maps.geotiff import files_of, open_dsm, open_ortho
from visloc_companion.sim.scene import Scene

GREY = np.random.default_rng(4).integers(1, 255, (64, 64), np.uint8)
EAST, NORTH = 604_000.0, 5_350_000.0


def beside_a_world_file(path: Path, driver: str) -> Path:
    profile = {"width": 64, "height": 64, "count": 1, "dtype": "uint8"}
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(path, "w", driver, **profile) as out:
        out.write(GREY, 1)
    world = path.with_suffix({"GTiff": ".tfw", "PNG": ".pgw", "JPEG": ".jgw"}[driver])
    world.write_text(f"0.5\n0\n0\n-0.5\n{EAST}\n{NORTH}\n")
    return path


@pytest.mark.parametrize(
    ("name", "driver", "remedy"),
    [
        ("a.tif", "GTiff", r"gdal_edit\.py -a_srs EPSG:CODE FILE, with"),
        ("a.png", "PNG", r"gdal_translate -a_srs EPSG:CODE FILE NEW\.tif, with"),
        ("a.jpg", "JPEG", r"gdal_translate -a_srs EPSG:CODE FILE NEW\.tif, with"),
    ],
)
def test_a_crs_is_stated_in_a_way_that_the_format_allows(tmp_path: Path, name: str, driver: str, remedy: str) -> None:
    """gdal_edit.py: "The PNG driver does not support update access to existing datasets"."""
    path = beside_a_world_file(tmp_path / name, driver)
    with pytest.raises(DatumMissing, match=rf"{name}: has no coordinate reference system; remedy: {remedy}"):
        open_ortho(path)
    path.with_suffix(".prj").write_text(CRS.from_epsg(32632).to_wkt(version="WKT1_ESRI"))
    with pytest.raises(DatumMissing, match=rf"remedy: gdal_translate -a_srs {tmp_path}/a\.prj FILE NEW\.tif"):
        open_ortho(path)


def test_a_file_of_several_rasters_names_one(tmp_path: Path) -> None:
    path = tmp_path / "a.gpkg"
    profile = {"width": 64, "height": 64, "count": 1, "dtype": "uint8", "crs": "EPSG:32632", "TILE_FORMAT": "PNG"}
    for table in ("north", "south"):
        options = profile | {"RASTER_TABLE": table, "APPEND_SUBDATASET": "YES" if path.exists() else "NO"}
        with rasterio.open(path, "w", "GPKG", transform=Affine(0.5, 0, EAST, 0, -0.5, NORTH), **options) as out:
            out.write(GREY, 1)
    with pytest.raises(MapError, match=r"a\.gpkg: holds 2 rasters, such as GPKG:.*:(north|south); remedy: .*gdal_translate"):
        open_ortho(path)


@pytest.mark.parametrize("open_one", [open_ortho, open_dsm])
def test_complex_numbers_are_no_picture(tmp_path: Path, open_one: Callable[[Path], object]) -> None:
    """Their real part was taken for the picture, or for heights, with no more than a ComplexWarning of numpy's."""
    path = tmp_path / "a.tif"
    profile = {"width": 64, "height": 64, "count": 1, "dtype": "complex64", "crs": "EPSG:32632"}
    with rasterio.open(path, "w", "GTiff", transform=Affine(0.5, 0, EAST, 0, -0.5, NORTH), **profile) as out:
        out.write(GREY.astype(np.complex64), 1)
    with pytest.raises(MapError, match=r"a\.tif: holds complex numbers, .*; remedy: .*gdal_calc\.py"):
        open_one(path)


PIXELS = {
    "identity": Affine.identity(),
    "north up": Affine(1, 0, 0, 0, -1, 0),
    "up from zero": Affine(1, 0, 0, 0, -1, 64),
    "centres": Affine(1, 0, -0.5, 0, -1, 0.5),
}


@pytest.mark.parametrize("counted", PIXELS)
def test_a_world_file_is_taken_where_the_raster_only_counts_its_pixels(tmp_path: Path, counted: str) -> None:
    """GDAL would take the GeoTIFF's own word and put the map at 0, 0."""
    path = tmp_path / "a.tif"
    profile = {"width": 64, "height": 64, "count": 1, "dtype": "uint8", "crs": "EPSG:32632", "transform": PIXELS[counted]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", "GTiff", **profile) as out:
            out.write(GREY, 1)
    with pytest.raises(DatumMissing, match=r"a\.tif: has no georeference; remedy: lay its world file beside it \(\.tfw\), or"):
        open_ortho(path)
    path.with_suffix(".tfw").write_text(f"0.5\n0\n0\n-0.5\n{EAST}\n{NORTH}\n")
    tiff = open_ortho(path)
    assert np.allclose(tiff.T_map_pix, [[0.5, 0, EAST], [0, -0.5, NORTH]])
    tiff.dataset.close()
    assert files_of(path) == [path, path.with_suffix(".tfw")], "what its place comes from is hashed with it"
    scene = Scene.load(path)
    assert np.allclose(scene.T_map_pix, tiff.T_map_pix)


def test_a_georeference_stands_against_a_world_file(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    place = Affine(1, 0, EAST, 0, -1, NORTH)
    with rasterio.open(path, "w", "GTiff", width=64, height=64, count=1, dtype="uint8", crs="EPSG:32632", transform=place) as out:
        out.write(GREY, 1)
    path.with_suffix(".tfw").write_text("0.5\n0\n0\n-0.5\n600000\n5000000\n")
    tiff = open_ortho(path)
    assert np.allclose(tiff.T_map_pix, [[1, 0, EAST + 0.5], [0, -1, NORTH - 0.5]])
    tiff.dataset.close()


@pytest.mark.parametrize(
    ("name", "remedy"), [("a.kmz", "make a GeoTIFF of it with a program that reads it"), ("a.tif", "copy or download the file")]
)
def test_a_format_that_is_not_read_is_no_damaged_download(tmp_path: Path, name: str, remedy: str) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04" + bytes(200))
    with pytest.raises(MapError, match=rf"{name}: cannot be opened as a raster: .*; remedy: {remedy}"):
        open_ortho(tmp_path / name)
