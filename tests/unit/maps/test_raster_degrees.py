"""Orthophotos whose coordinates are degrees, run on beyond the antimeridian, or are no place at all."""

import math
from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.errors import MapError
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.raster import RasterMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import GeoPoint


@pytest.mark.parametrize("middle_deg", [180.0, -180.0, 190.0])
def test_longitudes_beyond_the_antimeridian_are_those_of_the_other_side(tmp_path: Path, write_raster, middle_deg: float) -> None:
    pixels = np.full((640, 640, 3), 90, np.uint8)
    write_raster(tmp_path / "a.tif", pixels, "EPSG:4326", (-17.0, middle_deg), 0.5)
    ref = RasterMap.open(tmp_path / "a.tif")
    for away_deg in (-0.0005, 0.0, 0.0005):
        for turn_deg in (-360.0, 0.0, 360.0):
            lon_deg = middle_deg + away_deg + turn_deg
            place = ref.to_map(-17.0, lon_deg)
            assert place == pytest.approx((middle_deg + away_deg, -17.0), abs=1e-9)
            assert ref.covers(-17.0, lon_deg)
            assert ref.projection_at(GeoPoint(-17.0, lon_deg, 0.0)).origin_map_m == pytest.approx(place, abs=1e-9)
            assert -180 <= ref.to_geo(*place)[1] <= 180
            assert math.remainder(ref.to_geo(*place)[1] - lon_deg, 360) == pytest.approx(0.0, abs=1e-9)
    assert not ref.covers(-17.0, middle_deg + 1.0)


@pytest.mark.parametrize("crs", ["EPSG:3857", "EPSG:3395"])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_raster_in_mercator_may_run_on_beyond_the_antimeridian(tmp_path: Path, write_raster, crs: str, side: int) -> None:
    """GDAL writes its eastings on and on; half of it was no part of the map, and about its middle no pack could be made."""
    pixels = np.random.default_rng(1).integers(1, 255, (640, 640), dtype=np.uint8)
    write_raster(tmp_path / "a.tif", pixels, crs, (-17.0, side * 180.0), 0.5)
    ref = RasterMap.open(tmp_path / "a.tif")
    middle = ref.center_map_m
    for away_deg in (-0.0005, 0.0, 0.0005):
        place = ref.to_map(-17.0, side * 180.0 + away_deg)
        assert place[0] - middle[0] == pytest.approx(away_deg * 111_320, abs=2.0)
        assert ref.covers(-17.0, side * 180.0 + away_deg)
        assert math.remainder(ref.to_geo(*place)[1] - 180.0 - away_deg, 360) == pytest.approx(0.0, abs=1e-9)
    assert not ref.covers(-17.0, side * 180.0 + 0.01)
    manifest = build_pack([tmp_path / "a.tif"], None, tmp_path / "pack")
    assert manifest.share_valid > 0.95 and manifest.gsd_m == pytest.approx(0.5, rel=0.01)


def test_only_where_eastings_grow_evenly_all_around_is_there_a_turn() -> None:
    assert map_crs("EPSG:4326").turn == pytest.approx(360.0)
    assert map_crs("EPSG:3857").turn == pytest.approx(2 * math.pi * 6378137.0)
    assert [map_crs(text).turn for text in ("EPSG:32660", "EPSG:6933", "ESRI:54009")] == [None] * 3


@pytest.mark.parametrize(
    ("crs", "corner"),
    [("EPSG:32633", (5e7, 5e6)), ("EPSG:32633", (np.inf, 5e6)), ("EPSG:4326", (5e5, 5.2e6)), ("EPSG:4326", (47.0, 115.0))],
)
def test_coordinates_that_are_no_place_in_the_crs_are_named(tmp_path: Path, crs: str, corner: tuple[float, float]) -> None:
    transform = rasterio.Affine(1e-5, 0, corner[0], 0, -1e-5, corner[1])
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8", crs=crs, transform=transform
    ) as out:
        out.write(np.full((1, 9, 9), 9, np.uint8))
    with pytest.raises(MapError, match=r"a\.tif: its middle, .* is no place in WGS 84.*remedy"):
        RasterMap.open(tmp_path / "a.tif")
