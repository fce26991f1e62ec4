"""Orthophotos whose coordinates are degrees, or no place at all."""

import math
from pathlib import Path

import numpy as np
import pytest
import rasterio

from visloc_companion.errors import MapError
from visloc_companion.maps.raster import RasterMap
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
