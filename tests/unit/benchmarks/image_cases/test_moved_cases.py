"""Cases beside lines that have moved, and ground that is laid out alike, as claims are fitted on them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.evaluate.cases import Case, read_cases, read_frame, read_truth
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint

MIDDLE_M = (605_000.0, 5_349_000.0)


def ground(seed: int, date: str, size_m: float, gsd_m: float) -> Scene:
    """Noise, the same on both dates, over a plane of 200 m."""
    side = round(size_m / gsd_m)
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3), dtype=np.uint8)
    T = np.array([[gsd_m, 0.0, MIDDLE_M[0] - size_m / 2], [0.0, -gsd_m, MIDDLE_M[1] + size_m / 2]])
    return Scene(pixels, np.full((side, side), 200.0, np.float32), T, "EPSG:32632")


@pytest.fixture
def cases(load, monkeypatch, tmp_path) -> Path:
    module = load("image_cases.moved_cases")
    monkeypatch.setattr(module, "build_landscape", ground)
    moved = module.Moved((31, 32), ("shore", "flood"), (0.0, 20.0), (0.5, 1.0), shares=(0.5,))
    return module.write_moved(tmp_path / "lines", moved)


def test_each_case_has_its_frame_its_map_and_where_the_camera_was(cases):
    told, truth = read_cases(cases), read_truth(cases)
    assert [case.case_id for case in told] == [f"{k}_{m}_00{n}" for k in ("shore31", "flood32") for m in (0, 20) for n in (0, 1)]
    for case in told:
        assert isinstance(case, Case)
        at = truth[case.case_id]
        off_m = distance_m(case.prior.place, GeoPoint(at.lat_deg, at.lon_deg, case.prior.place.h_amsl_m))
        assert 0.1 < off_m < 45.0
        assert 100.0 < at.h_m - 200.0 < 140.0
        assert at.gsd_m == (0.5 if case.case_id.startswith("shore") else 1.0)
        assert at.solvable
    with (cases / "truth.csv").open(encoding="utf-8") as stream:
        assert [row["frame_date"] for row in csv.DictReader(stream)] == ["ordinary"] * 4 + ["changed"] * 4


def test_the_line_has_moved_in_the_frame_and_not_under_it(cases):
    told = {case.case_id: case for case in read_cases(cases) if isinstance(case, Case)}
    still, moved = (read_frame(told[f"shore31_{m}_000"].frame) for m in (0, 20))
    assert still is not None
    assert moved is not None
    assert told["shore31_0_000"].prior == told["shore31_20_000"].prior
    assert told["shore31_0_000"].ortho == told["shore31_20_000"].ortho
    changed = np.abs(still.astype(float) - moved.astype(float)).mean(axis=2) > 25
    assert 0.05 < changed.mean() < 0.5


def test_a_coarser_scene_shows_the_same_places(load):
    fine = ground(1, "map", 40.0, 0.5)
    coarse = load("image_cases.moved_cases").coarser(fine, 4)
    assert coarse.size_px == (20, 20)
    assert coarse.pixels[3, 5].astype(float) == pytest.approx(fine.pixels[12:16, 20:24].mean(axis=(0, 1)), abs=0.6)
    middle = fine.T_map_pix @ np.array([21.5, 13.5, 1.0])
    assert coarse.T_map_pix @ np.array([5.0, 3.0, 1.0]) == pytest.approx(middle)


def test_squares_are_laid_out_alike_over_level_ground(load, monkeypatch):
    worlds = load("worlds.look_alike_worlds")
    monkeypatch.setattr(worlds, "build_landscape", ground)
    periodic = worlds.scene_of(worlds.KINDS.index("periodic"), "map", 200.0, worlds.GSD_M)
    side = round(worlds.BLOCK_M / worlds.GSD_M)
    assert np.array_equal(periodic.pixels[:side, :side], periodic.pixels[side : 2 * side, 2 * side : 3 * side])
    assert not periodic.dsm_amsl_m.any()
    own = worlds.scene_of(worlds.KINDS.index("ordinary"), "map", 200.0, worlds.GSD_M)
    assert not np.array_equal(own.pixels[:side, :side], own.pixels[side : 2 * side, 2 * side : 3 * side])
    with pytest.raises(ValueError, match=r"0\.5 m a pixel, not 1\.0"):
        worlds.scene_of(2, "map", 200.0, 1.0)


def test_a_frame_over_level_ground_may_be_as_small_as_it_is_told(load, monkeypatch, tmp_path):
    module = load("image_cases.landscape_cases")
    worlds = module.Worlds((3,), 1, (0.5,), 48, scene_of=ground, least_m=0.0)
    folder = module.write_landscape(tmp_path / "small", worlds)
    (truth,) = read_truth(folder).values()
    assert truth.h_m - 200.0 == pytest.approx(48 * 0.5 / 2 / np.tan(np.radians(30)), rel=0.09)
    lat_deg, lon_deg = map_crs("EPSG:32632").to_geo(*MIDDLE_M)
    assert distance_m(GeoPoint(truth.lat_deg, truth.lon_deg, 0.0), GeoPoint(lat_deg, lon_deg, 0.0)) < 400.0
