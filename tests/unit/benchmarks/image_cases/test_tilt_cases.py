"""Cases whose tilt the prior does not know, and the fit that takes what a claimed sigma leaves open for itself."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.scene import Scene

PLACE_M = (605_000.0, 5_349_000.0)
SLOPE = 0.1


@pytest.fixture
def source(tmp_path, load) -> Path:
    """Three frames over a surface that climbs from 200 m at the middle, tilted by 5, 20 and 8 degrees."""
    column = np.arange(200, dtype=np.float32) - 100
    surface = np.tile(200 + SLOPE * column, (200, 1)).astype(np.float32)
    T = np.array([[1.0, 0.0, PLACE_M[0] - 100], [0.0, -1.0, PLACE_M[1] + 100]])
    ortho, dsm = Scene(np.zeros((200, 200, 3), np.uint8), surface, T, "EPSG:32632").save(tmp_path / "world")
    lat, lon = map_crs("EPSG:32632").to_geo(*PLACE_M)
    folder = tmp_path / "told"
    folder.mkdir()
    cases = [
        {"id": f"c{k}", "frame": f"frames/c{k}.png", "ortho": ortho, "dsm": dsm, "prior_h_m": 303.0}
        | {"prior_roll_deg": roll, "prior_pitch_deg": 1.0, "prior_yaw_deg": 7.0, "sigma_tilt_deg": 0.3}
        for k, roll in enumerate((5, 20, 8))
    ]
    truths = [
        {"id": c["id"], "lat_deg": lat, "lon_deg": lon, "h_m": 300.0, "roll_deg": c["prior_roll_deg"], "pitch_deg": 0.0}
        for c in cases
    ]
    return load("image_cases.cases").write_tables(folder, cases, truths)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_prior_says_nadir_of_all_that_tilt_little_enough(source, load, tmp_path):
    folder = load("image_cases.tilt_cases").untold(source, tmp_path / "untold", largest_deg=12.0, n=5)
    cases, truths = _rows(folder / "cases.csv"), _rows(folder / "truth.csv")
    assert [case["id"] for case in cases] == [truth["id"] for truth in truths] == ["c0", "c2"]
    assert {(c["prior_roll_deg"], c["prior_pitch_deg"], c["sigma_tilt_deg"]) for c in cases} == {("0.0", "0.0", "6.0")}
    assert [truth["roll_deg"] for truth in truths] == ["5", "8"]
    assert cases[0]["frame"] == str(source / "frames" / "c0.png")
    assert cases[0]["dsm"]


def test_without_surface_heights_count_from_the_mean_under_the_frame(source, load, tmp_path):
    folder = load("image_cases.tilt_cases").untold(source, tmp_path / "plane", largest_deg=12.0, n=1, without_surface=True)
    (case,), (truth,) = _rows(folder / "cases.csv"), _rows(folder / "truth.csv")
    assert case["dsm"] == ""
    assert float(truth["h_m"]) == pytest.approx(100.0, abs=0.2)
    assert float(case["prior_h_m"]) - float(truth["h_m"]) == pytest.approx(3.0)


def test_a_folder_that_is_there_is_kept(source, load, tmp_path):
    module = load("image_cases.tilt_cases")
    folder = module.untold(source, tmp_path / "untold", largest_deg=12.0, n=1)
    assert module.untold(source, folder, largest_deg=90.0, n=9) == folder
    assert len(_rows(folder / "cases.csv")) == 1


def test_what_the_sigma_leaves_open_is_not_the_place_s_fault(load):
    """Weights of the place are found again from data of which a known share is wrong for another cause."""
    rng = np.random.default_rng(3)
    x = np.column_stack([np.ones(6000), rng.normal(size=(6000, 2))])
    weights, sure = np.array([1.0, 2.0, -1.0]), rng.uniform(0.4, 1.0, 6000)
    y = (rng.uniform(size=6000) < sure / (1 + np.exp(-x @ weights))).astype(float)
    module = load("calibrate")
    fitted = module.fit_logistic(x, y, sure)
    assert fitted == pytest.approx(weights, abs=0.25)
    assert module.probability_wrong(x, fitted, sure).mean() == pytest.approx(1 - y.mean(), abs=0.01)
