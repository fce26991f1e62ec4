from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine

from visloc_companion.evaluate.cases import Camera, Case
from visloc_companion.evaluate.image import run_case
from visloc_companion.evaluate.search_reach import LEAST_M, MOST_M, search_reach_m
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import GeoPoint, PosePrior

SIDE_PX, PIXEL_M = 320, 20.0
EASTING, NORTHING = 500_000.0, 5_205_353.0
"""The upper left corner, on the central meridian of UTM 32N."""


def texture() -> np.ndarray:
    rng = np.random.default_rng(4)
    image = np.full((SIDE_PX, SIDE_PX), 110, np.uint8)
    for _ in range(350):
        box = cv2.boxPoints((tuple(rng.uniform(0, 310, 2)), tuple(rng.uniform(4, 40, 2)), rng.uniform(0, 180)))
        cv2.fillPoly(image, [np.int32(box)], int(rng.uniform(30, 220)))
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def geotiff(path: Path, image: np.ndarray, crs: str, transform: Affine) -> Path:
    rows, cols = image.shape
    shape = {"width": cols, "height": rows, "count": 1, "dtype": "uint8"}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, **shape) as out:
        out.write(image, 1)
    return path


def wide_map(folder: Path) -> Path:
    """6.4 x 6.4 km."""
    return geotiff(folder / "map.tif", texture(), "EPSG:32632", Affine(PIXEL_M, 0, EASTING, 0, -PIXEL_M, NORTHING))


def place(col: float, row: float, h_m: float = 0.0) -> GeoPoint:
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(EASTING + PIXEL_M * col, NORTHING - PIXEL_M * row)
    return GeoPoint(lat, lon, h_m)


def test_the_search_reaches_the_maps_farthest_corner_within_limits(tmp_path: Path) -> None:
    reference = RasterMap.open(wide_map(tmp_path))
    assert search_reach_m(place(0, 0), reference) == pytest.approx(6400 * math.sqrt(2), rel=2e-3)
    assert search_reach_m(place(160, 160), reference) == pytest.approx(3200 * math.sqrt(2), rel=2e-3)
    assert search_reach_m(place(160, 3000), reference) == MOST_M
    small = geotiff(tmp_path / "small.tif", texture(), "EPSG:32632", Affine(1, 0, EASTING, 0, -1, NORTHING))
    assert search_reach_m(place(0, 0), RasterMap.open(small)) == LEAST_M


def test_the_search_reaches_across_the_antimeridian(tmp_path: Path) -> None:
    side_deg = 0.06 / SIDE_PX
    beside = geotiff(tmp_path / "map.tif", texture(), "EPSG:4326", Affine(side_deg, 0, 179.97, 0, -side_deg, 0.03))
    expected_m = 0.03 * math.sqrt(2) * 111_000
    for lon_deg in (180.0, -180.0):
        assert search_reach_m(GeoPoint(0.0, lon_deg, 0.0), RasterMap.open(beside)) == pytest.approx(expected_m, rel=5e-3)


def test_a_frame_is_found_as_far_from_its_prior_as_three_sigmas_allow(tmp_path: Path) -> None:
    """3.6 km off on a map of 6.4 x 6.4 km, where a flight searches 2 km."""
    col, row, height_m = 90, 250, 100 * PIXEL_M
    frame = tmp_path / "frame.png"
    cv2.imwrite(str(frame), texture()[row - 50 : row + 50, col - 60 : col + 60])
    truth, prior = place(col, row, height_m), place(col + 130, row - 125, height_m)
    off_m = math.hypot(*ned_from_geo(truth, prior)[:2])
    assert off_m > 1.5 * LEAST_M
    sigma_m = 1300.0
    assert off_m < 3 * sigma_m
    case = Case(
        "far",
        frame,
        wide_map(tmp_path),
        None,
        Camera(100.0, 100.0, 59.5, 49.5, (0.0,) * 5),
        PosePrior(
            prior,
            quat_from_euler(0.0, 0.0, math.radians(1)),
            ((sigma_m**2, 0.0), (0.0, sigma_m**2)),
            0.02 * height_m,
            math.radians(1.5),
            math.radians(0.1),
        ),
    )
    result = run_case(case, "gradient")
    assert result.fix is not None, result.detail
    assert math.hypot(*ned_from_geo(result.fix.place, truth)[:2]) < 2 * PIXEL_M
