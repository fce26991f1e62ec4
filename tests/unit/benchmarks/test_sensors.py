"""The variations of cameras and maps are what their names say, and repeat."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from benchmarks.image_cases import sensor_variations as seen
from benchmarks.image_cases.cases import MAKER, maker
from benchmarks.image_cases.sensor_cases import SIZES, write_map
from benchmarks.image_cases.sensor_maps import MAPS
from benchmarks.sensors import COLUMNS, row
from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.types import Fix, GeoPoint

needs_maker = pytest.mark.skipif(not MAKER.exists(), reason="needs ../shared")


@pytest.fixture(scope="module")
def bands() -> seen.Bands:
    """Smooth ground, each band another."""
    rng = np.random.default_rng(2)
    parts = [cv2.GaussianBlur(rng.normal(0, 1, (256, 256)), (0, 0), 6) for _ in range(4)]
    return np.dstack([np.clip(110 + 30 * part / part.std(), 0, 255) for part in parts]).astype(np.uint8)


@pytest.mark.parametrize("name", seen.FRAMES)
def test_frames_are_of_the_pictures_size_and_repeat(bands: seen.Bands, name: str) -> None:
    before = bands.copy()
    first, again = (seen.FRAMES[name](bands, np.random.default_rng(4)) for _ in range(2))
    assert first.shape[:2] == (256, 256)
    assert first.ndim == 2 or first.shape[2] == 3
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert np.array_equal(bands, before), "the picture itself stays as it is"
    assert name in ("colour", "grey") or not np.array_equal(
        first, seen.FRAMES["grey" if first.ndim == 2 else "colour"](bands, np.random.default_rng(4))
    )


@pytest.mark.parametrize("name", MAPS)
def test_maps_show_the_same_ground(bands: seen.Bands, name: str) -> None:
    drawn = MAPS[name](bands, bands[::-1], np.random.default_rng(4))
    times = {"2 times coarser": 2, "4 times coarser": 4}.get(name, 1)
    assert drawn.shape[:2] == (256 // times, 256 // times)
    assert drawn.dtype == np.uint8
    assert np.array_equal(drawn, MAPS[name](bands, bands[::-1], np.random.default_rng(4)))


def test_night_has_a_quarter_of_its_mean_of_noise(bands: seen.Bands) -> None:
    noise = seen.night_gain(bands, np.random.default_rng(1)).astype(float) - seen.grey(bands)
    assert noise.std() == pytest.approx(seen.grey(bands).mean() / 4, rel=0.1)


def test_a_thermal_like_picture_has_few_levels(bands: seen.Bands) -> None:
    assert len(np.unique(seen.thermal_like(bands, np.random.default_rng(1)))) <= 34


def test_corners_have_a_quarter_of_the_light() -> None:
    white = np.full((101, 101, 4), 200, np.uint8)
    dimmed = seen.vignetting(white, np.random.default_rng(1))
    assert dimmed[0, 0, 0] == pytest.approx(50, abs=1)
    assert dimmed[50, 50, 0] == 200


def test_a_mosaic_holds_the_bands_in_turn_and_a_wrong_one_swaps_them() -> None:
    plain = np.empty((16, 16, 4), np.uint8)
    plain[:] = (200, 100, 20, 0)
    raw = seen.undemosaiced(plain, np.random.default_rng(1))
    assert raw[:2, :2].tolist() == [[200, 100], [100, 20]]
    red, green, blue = seen.wrong_mosaic(plain, np.random.default_rng(1))[8, 8].tolist()
    assert (red, blue) == (100, 100), "red and blue are green's"
    assert green in (200, 20, 110)


def test_seams_take_fields_of_both_dates(bands: seen.Bands) -> None:
    dark, light = np.full((200, 200, 4), 50, np.uint8), np.full((200, 200, 4), 100, np.uint8)
    drawn = MAPS["seams of two dates"](dark, light, np.random.default_rng(1))
    assert sorted(set(drawn.ravel().tolist())) == [50, 135]


@needs_maker
@pytest.mark.parametrize(
    ("name", "shape"), [("320 x 240", (240, 320)), ("portrait, 480 x 640", (640, 480)), ("4000 x 3000", (3000, 4000))]
)
def test_sizes_keep_the_direction_of_every_pixel(bands: seen.Bands, name: str, shape: tuple[int, int]) -> None:
    """A mark that the camera of 256 px sees in a direction lies in the same direction of the new one."""
    marked = np.zeros_like(bands)
    marked[100:104, 140:144] = 255
    pixels, of = SIZES[name](marked)
    assert pixels.shape[:2] == shape
    v, u = (float(np.average(axis, weights=pixels[..., 0])) for axis in np.indices(shape))
    tool = maker()
    assert (u - of["cx_px"]) / of["fx_px"] == pytest.approx((141.5 - tool.CENTRE_PX) / tool.FOCAL_PX, abs=2e-3)
    assert (v - of["cy_px"]) / of["fy_px"] == pytest.approx((101.5 - tool.CENTRE_PX) / tool.FOCAL_PX, abs=2e-3)


@needs_maker
def test_pixels_that_are_no_squares_have_two_focal_lengths(bands: seen.Bands) -> None:
    pixels, of = SIZES["pixels 1.5 times as wide as high"](bands)
    assert pixels.shape[:2] == (360, 320)
    assert of["fy_px"] == pytest.approx(1.5 * of["fx_px"])


@pytest.mark.parametrize("bands_of", [1, 3])
def test_a_map_is_written_where_it_lies(tmp_path: Path, bands: seen.Bands, bands_of: int) -> None:
    picture = bands[..., 0] if bands_of == 1 else seen.colour(bands)
    write_map(tmp_path / "maps" / "a.tif", picture, Affine(5.0, 0.0, 500_000.0, 0.0, -5.0, 5_000_000.0), "EPSG:32614")
    with rasterio.open(tmp_path / "maps" / "a.tif") as source:
        assert (source.count, source.crs.to_epsg(), source.transform.a) == (bands_of, 32614, 5.0)
        assert np.array_equal(source.read(1), bands[..., 0])


def test_a_row_counts_right_far_and_refused() -> None:
    def result(case: str, north_deg: float, p: float = 0.01) -> CaseResult:
        place, level = GeoPoint(48.0 + north_deg, 11.0, 100.0), (1.0, 0.0, 0.0, 0.0)
        return CaseResult(case, Fix(0, 0, 1, 1, "deep", place, level, ((4.0, 0.0), (0.0, 4.0)), 1.0, 0.01, p, 1.0), None)

    truth = Truth(48.0, 11.0, 100.0, 0.0, 5.0, True)
    refused = CaseResult("d", None, Reason.NO_MATCH)
    judged = [(result("a", 1e-5), truth), (result("b", 1e-3), truth), (result("c", 0.0, 0.5), truth), (refused, truth)]
    cells = [cell.strip() for cell in row("camera", judged).strip("|").split("|")]
    assert len(cells) == len(COLUMNS)
    assert cells[:5] == ["camera", "4", "1", "1", "2"]
    assert float(cells[5]) == pytest.approx(0.22, abs=0.01)
    assert cells[7] == "no_match 2"
