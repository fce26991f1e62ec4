from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.windows import Window

from visloc_companion.evaluate.cases import BadCase, Camera, Case, Truth
from visloc_companion.evaluate.images.image_breakdown import Ground, breakdown, ground_under, season_days_apart, years_apart
from visloc_companion.evaluate.images.image_metrics import CaseResult, summarise
from visloc_companion.evaluate.images.image_pictures import SIDE_PX, case_pictures
from visloc_companion.evaluate.images.image_report import write_image_report
from visloc_companion.evaluate.images.image_worst import worst_cases
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import Fix, GeoPoint, PosePrior

MIDDLE = GeoPoint(47.0, 9.0, 0.0)
SIZE, FOCAL = 240, 100.0


@pytest.fixture
def world(tmp_path, write_raster) -> Path:
    """1 m pixels, four bands: a lake in the west, a rough wood in the north-east, a smooth field in the south-east."""
    rng = np.random.default_rng(1)
    rgb = np.full((SIZE, SIZE, 3), 120, np.float32)
    rgb[: SIZE // 2, SIZE // 2 :] += rng.normal(0, 30, (SIZE // 2, SIZE // 2, 1))
    rgb[:, : SIZE // 2] = (30, 60, 60)
    near_infrared = np.where(np.arange(SIZE) < SIZE // 2, 20, 160)[None, :, None].repeat(SIZE, 0)
    values = np.clip(np.concatenate([rgb, near_infrared], 2), 0, 255).astype(np.uint8)
    write_raster(tmp_path / "map.tif", values, "EPSG:32632", (MIDDLE.lat_deg, MIDDLE.lon_deg), 1.0)
    return tmp_path


def case_at(world: Path, name: str, north_m: float, east_m: float) -> tuple[Case, Truth]:
    """A frame of 40 x 40 m, 40 m above the plane, with a white square 8 m north of its middle."""
    frame = np.zeros((100, 100, 3), np.uint8)
    frame[20:40, 40:60] = 255
    cv2.imwrite(str(world / f"{name}.png"), frame)
    place = geo_from_ned((north_m, east_m, -40.0), MIDDLE)
    prior = PosePrior(place, quat_from_euler(0, 0, 0), ((25.0, 0.0), (0.0, 25.0)), 2.0, 0.05, 0.01)
    camera = Camera(FOCAL, FOCAL, 49.5, 49.5, (0, 0, 0, 0, 0))
    truth = Truth(place.lat_deg, place.lon_deg, 40.0, 0.0, 1.0, True, map_date="20100701", frame_date="20160801")
    return Case(name, world / f"{name}.png", world / "map.tif", None, camera, prior), truth


def answer(truth: Truth, name: str, off_m: float = 0.0, p: float = 0.01) -> CaseResult:
    place = geo_from_ned((off_m, 0.0, 0.0), GeoPoint(truth.lat_deg, truth.lon_deg, truth.h_m))
    fix = Fix(0, 0, 0, 0, "gradient", place, quat_from_euler(0, 0, 0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, p, 1.0)
    return CaseResult(name, fix, None, elapsed_ms=3.0, evidence={"agl_m": 40.0, "score": 0.5})


@pytest.mark.parametrize(
    ("north_m", "east_m", "cover"), [(0, -70, "water"), (60, 60, "rough"), (-60, 60, "smooth"), (-60, 8, "shore")]
)
def test_the_cover_is_that_under_the_frame(world, north_m, east_m, cover):
    case, truth = case_at(world, "a", north_m, east_m)
    ground = ground_under(case, truth, 40.0)
    assert ground is not None
    assert ground.cover == cover
    assert (ground.texture > 8) == (cover == "rough")


def test_no_ground_is_known_off_the_map_or_without_files(world):
    case, truth = case_at(world, "a", 0, 0)
    assert ground_under(BadCase("a", "why"), truth, 40.0) is None
    assert ground_under(replace(case, ortho=world / "absent.tif"), truth, 40.0) is None
    assert ground_under(case, replace(truth, lat_deg=48.0), 40.0) is None


@pytest.mark.parametrize("crs", [None, "EPSG:4978", "EPSG:4326"])
def test_no_ground_is_known_where_the_map_states_no_place(world, crs):
    """Such cases have no fix; the report of the others comes all the same."""
    case, truth = case_at(world, "a", 0, 0)
    with rasterio.open(case.ortho) as source, rasterio.open(world / "bare.tif", "w", **{**source.profile, "crs": crs}) as bare:
        bare.write(source.read())
    assert ground_under(replace(case, ortho=world / "bare.tif"), truth, 40.0) is None
    assert ground_under(replace(case, ortho=world / "\udcff.tif"), truth, 40.0) is None


@pytest.mark.parametrize("photometric", ["MINISBLACK", "MINISWHITE"])
def test_water_of_a_grey_map_is_dark_whichever_way_its_values_count(world, write_raster, photometric):
    case, truth = case_at(world, "a", -30, 30)
    grey = np.full((SIZE, SIZE), 40, np.uint8)
    stored = 255 - grey if photometric == "MINISWHITE" else grey
    middle = (MIDDLE.lat_deg, MIDDLE.lon_deg)
    write_raster(world / f"{photometric}.tif", stored, "EPSG:32632", middle, 1.0, photometric=photometric)
    ground = ground_under(replace(case, ortho=world / f"{photometric}.tif"), truth, 40.0)
    assert ground is not None and ground.cover == "water"


def test_only_the_part_of_the_map_under_the_frame_is_read(world):
    """Whole orthophotos may be larger than the memory; what is beside the part counts for its edges as in the whole."""
    case, truth = case_at(world, "a", 0, -30)
    whole = ground_under(case, truth, 40.0)
    with rasterio.open(case.ortho) as source:
        profile, bands = source.profile, source.read()
    vast = {"width": 90_000, "height": 90_000, "tiled": True, "blockxsize": 512, "blockysize": 512}
    vast |= {"sparse_ok": True, "compress": "deflate", "bigtiff": "yes"}
    with rasterio.open(world / "vast.tif", "w", **{**profile, **vast}) as target:  # 130 GB as float32, were all of it read
        target.write(bands, window=Window(0, 0, SIZE, SIZE))
    found = ground_under(replace(case, ortho=world / "vast.tif"), truth, 40.0)
    assert found is not None and whole is not None
    assert (found.cover, found.texture) == (whole.cover, pytest.approx(whole.texture, rel=0.05))


def test_dates_are_apart_by_years_and_by_season():
    assert years_apart("20100701", "20160801") == pytest.approx(6.08, abs=0.01)
    assert season_days_apart("20100701", "20160801") == pytest.approx(31, abs=1.5)
    assert season_days_apart("20101220", "20150105") == pytest.approx(16, abs=1.5)
    assert years_apart("a", "20100701") is None
    assert season_days_apart("20101341", "20100701") is None


def test_breakdown_counts_every_solvable_case_once_in_each_group(world):
    truth = case_at(world, "a", 0, 0)[1]
    grounds = {str(k): Ground(("water", "rough")[k % 2], float(k)) for k in range(8)}
    judged = [(answer(truth, str(k), off_m=12.0 * (k == 7), p=0.2 * (k == 6)), truth) for k in range(8)]
    rows = breakdown([*judged, (answer(truth, "x"), replace(truth, solvable=False))], grounds, 0.05)
    totals = {group: sum(r.n for r in rows if r.group == group) for group in {r.group for r in rows}}
    assert set(totals.values()) == {8}
    assert len(totals) == 4
    rough = next(r for r in rows if r.label == "rough")
    assert (rough.n, rough.within_5px, rough.accepted, rough.far) == (4, 0.75, 4, 1)
    assert next(r for r in rows if r.label == "water").accepted == 3
    assert sum(r.label.startswith("quartile") for r in rows) == 4


def test_pictures_lie_north_up_on_the_map(world):
    case, truth = case_at(world, "a", 0.0, 0.0)
    pictures = case_pictures(case, truth, answer(truth, "a", off_m=30.0))
    assert pictures is not None
    assert pictures.map_at_answer is not None
    rows, cols = np.nonzero(pictures.frame_at_truth[..., 0] > 128)
    scale = 40 * 1.15 / SIDE_PX
    assert SIDE_PX / 2 - rows.mean() == pytest.approx(8 / scale, abs=2)
    assert cols.mean() == pytest.approx(SIDE_PX / 2, abs=2)
    assert pictures.map_at_truth[:, :100, 2].mean() < pictures.map_at_truth[:, 120:, 2].mean()


def test_turned_frames_are_turned_back(world):
    case, truth = case_at(world, "a", 0.0, 0.0)
    pictures = case_pictures(case, replace(truth, yaw_deg=90.0), answer(truth, "a"))
    assert pictures is not None
    rows, cols = np.nonzero(pictures.frame_at_truth[..., 0] > 128)
    assert cols.mean() > rows.mean() + 20


def test_worst_are_the_accepted_far_ones_then_the_largest_errors(world):
    truth = case_at(world, "a", 0, 0)[1]
    judged = [(answer(truth, "small"), truth), (answer(truth, "refused", 50.0, 0.5), truth), (answer(truth, "far", 11.0), truth)]
    assert [r.case_id for r, _, _ in worst_cases(judged, 3, 0.05)] == ["far", "refused", "small"]


def test_report_shows_breakdown_claims_and_pictures(world, tmp_path):
    cases, truths = zip(*(case_at(world, name, 0, east) for name, east in (("a", -60), ("b", 60))), strict=True)
    truth = dict(zip(("a", "b"), truths, strict=True))
    results = [answer(truth["a"], "a", 20.0), answer(truth["b"], "b", p=0.3)]
    document = {"schema": 1, "method": "gradient", "summary": summarise(results, truth)}
    page = write_image_report(tmp_path / "out", document, results, truth, cases=cases, max_probability_wrong=0.05).read_text()
    for words in ("Are the claims true?", "land cover", "water", "The worst cases", "data:image/jpeg;base64", "(refused)"):
        assert words in page
    assert "http" not in page
    assert "nan" not in page
    assert math.isclose(page.count("<tr"), page.count("</tr>"))


def test_a_frame_that_cannot_be_read_has_no_pictures(world):
    case, truth = case_at(world, "a", 0, 0)
    assert case_pictures(replace(case, frame=world / "absent.png"), truth, answer(truth, "a")) is None
    assert case_pictures(replace(case, ortho=world / "absent.tif"), truth, answer(truth, "a")) is None
