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
from visloc_companion.evaluate.images.image import run_case
from visloc_companion.evaluate.images.search_reach import LEAST_M, MOST_M, search_reach_m
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


def place(col: float, row: float, h_m: float = 0.0, pixel_m: float = PIXEL_M) -> GeoPoint:
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(EASTING + pixel_m * col, NORTHING - pixel_m * row)
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


def placed_m(
    folder: Path, pixel_m: float, truth_px: tuple[int, int], prior_px: tuple[float, float], sigma_m: float
) -> tuple[float, float | None]:
    """How far a prior is off, and how far the fix of a frame cut out of the map at (column, row) is, metres (None: refused)."""
    col, row = truth_px
    height_m = 100 * pixel_m
    frame = folder / "frame.png"
    cv2.imwrite(str(frame), texture()[row - 50 : row + 50, col - 60 : col + 60])
    transform = Affine(pixel_m, 0, EASTING, 0, -pixel_m, NORTHING)
    truth, prior = place(col, row, height_m, pixel_m), place(*prior_px, height_m, pixel_m)
    case = Case(
        "far",
        frame,
        geotiff(folder / "map.tif", texture(), "EPSG:32632", transform),
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
    off_m = math.hypot(*ned_from_geo(truth, prior)[:2])
    return off_m, None if result.fix is None else math.hypot(*ned_from_geo(result.fix.place, truth)[:2])


def test_a_frame_is_found_as_far_from_its_prior_as_three_sigmas_allow(tmp_path: Path) -> None:
    """3.6 km off on a map of 6.4 x 6.4 km, where a flight searches 2 km."""
    sigma_m = 1300.0
    off_m, error_m = placed_m(tmp_path, PIXEL_M, (90, 250), (220, 125), sigma_m)
    assert 1.5 * LEAST_M < off_m < 3 * sigma_m
    assert error_m is not None
    assert error_m < 2 * PIXEL_M


@pytest.mark.parametrize(
    ("pixel_m", "prior_px", "sigma_m"),
    [
        pytest.param(0.1, (170.0, 150.0), 700.0, id="between the samples that look for the ground"),
        pytest.param(0.1, (3000.0, -1500.0), 200.0, id="beyond a window about the prior"),
    ],
)
def test_a_small_map_is_found_wherever_a_wide_prior_reaches_it(
    tmp_path: Path, pixel_m: float, prior_px: tuple[float, float], sigma_m: float
) -> None:
    """A map of 32 m a side, searched for within 2 km and within 600 m."""
    off_m, error_m = placed_m(tmp_path, pixel_m, (130, 200), prior_px, sigma_m)
    assert off_m < 2 * sigma_m
    assert error_m is not None
    assert error_m < 2 * pixel_m
