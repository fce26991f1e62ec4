"""What the benchmarks compute themselves; what they measure is the localisers' business."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.evaluate.images.map_sigma import MapSigma, with_map_sigma
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.localise.verify import AGAIN_WEIGHTS, DEEP_WEIGHTS, Evidence, probability_wrong
from visloc_companion.types import Fix, GeoPoint

HEADER = (
    "id,frame,ortho,dsm,fx_px,fy_px,cx_px,cy_px,distortion,prior_lat_deg,prior_lon_deg,prior_h_m,prior_roll_deg,prior_pitch_deg,"
    "prior_yaw_deg,sigma_horizontal_m,sigma_h_m,sigma_yaw_deg,sigma_tilt_deg"
)
COVARIANCE = ((2.0, 0.5), (0.5, 3.0))
FIX = Fix(0, 0, 0, 0, "gradient", GeoPoint(47.0, 9.0, 100.0), quat_from_euler(0.1, 0.2, 0.3), COVARIANCE, 1.0, 0.02, 0.25, 7.0)


@pytest.fixture
def folder(tmp_path) -> Path:
    path = tmp_path / "some_set"
    path.mkdir()
    rows = [f"c{k},f.png,map.tif,,100,100,50,50,,47,9,100,0,0,0,10,2,3,1" for k in range(5)]
    (path / "cases.csv").write_text("\n".join([HEADER, *rows]))
    truths = [f"c{k},47,9,100,0,0,0" for k in range(5)]
    (path / "truth.csv").write_text("\n".join(["id,lat_deg,lon_deg,h_m,roll_deg,pitch_deg,yaw_deg", *truths]))
    return path


@pytest.fixture
def asked(load, monkeypatch) -> list[str]:
    """The cases that were really localised, by a localiser that answers every other one."""
    seen: list[str] = []

    def run(cases, *_, **__):
        for case in cases:
            seen.append(case.case_id)
            fix, reason = (FIX, None) if int(case.case_id[1:]) % 2 == 0 else (None, Reason.NO_MATCH)
            yield CaseResult(case.case_id, fix, reason, "why", 3.5, {"score": 0.5}, 0.5)

    monkeypatch.setattr(load("image_cases.answers"), "run_cases", run)
    return seen


def test_answers_are_kept_as_they_were(load, folder, tmp_path, asked):
    answers = load("image_cases.answers").answers
    first = answers(folder, "ncc", tmp_path / "store", "abc")
    again = answers(folder, "ncc", tmp_path / "store", "abc")
    assert first == again
    assert asked == [f"c{k}" for k in range(5)]
    stated = with_map_sigma(FIX, MapSigma())
    assert first[0][0] == CaseResult("some_set/c0", stated, None, "why", 3.5, {"score": 0.5}, 0.5)
    assert first[1][0].reason is Reason.NO_MATCH


def test_what_is_kept_is_without_the_maps_error(load, folder, tmp_path, asked):
    answers = load("image_cases.answers").answers
    answers(folder, "ncc", tmp_path / "store", "abc")
    exact = answers(folder, "ncc", tmp_path / "store", "abc", map_sigma=MapSigma(0.0, 0.0, 0.0))
    assert exact[0][0].fix == FIX
    assert len(asked) == 5


def test_a_run_that_was_broken_off_goes_on(load, folder, tmp_path, asked):
    answers = load("image_cases.answers").answers
    whole = answers(folder, "ncc", tmp_path / "store", "abc")
    (file,) = (tmp_path / "store").iterdir()
    text = file.read_text()
    file.write_text(text[: text.index("\n", text.index("c2")) - 20])
    asked.clear()
    assert answers(folder, "ncc", tmp_path / "store", "abc") == whole
    assert asked == ["c2", "c3", "c4"]
    assert file.read_text() == text


def test_a_limit_is_filled_up_later_and_other_code_starts_anew(load, folder, tmp_path, asked):
    answers = load("image_cases.answers").answers
    assert len(answers(folder, "ncc", tmp_path / "store", "abc", limit=2)) == 2
    answers(folder, "ncc", tmp_path / "store", "abc")
    assert asked == [f"c{k}" for k in range(5)]
    answers(folder, "ncc", tmp_path / "store", "def", limit=1)
    assert asked[5:] == ["c0"]


def test_the_digest_follows_code_and_model(load, tmp_path, monkeypatch):
    module = load("image_cases.answers")
    package = tmp_path / "package"
    for room in module.CODE:
        (package / room).mkdir(parents=True)
    (package / "localise" / "dense.py").write_text("a = 1")
    (package / "localise" / "verify.py").write_text("b = 1")
    monkeypatch.setattr(module, "PACKAGE", package)
    before, evidence = module.code_digest(tmp_path), module.code_digest(tmp_path, without_verdict=True)
    (package / "localise" / "verify.py").write_text("b = 2")
    assert module.code_digest(tmp_path) != before
    assert module.code_digest(tmp_path, without_verdict=True) == evidence
    (tmp_path / "manifest.json").write_text("{}")
    assert module.code_digest(tmp_path, without_verdict=True) != evidence


def test_a_logistic_regression_finds_the_weights_that_made_the_data(load):
    rng = np.random.default_rng(2)
    x = np.column_stack([np.ones(4000), rng.normal(size=(4000, 2))])
    weights = np.array([0.5, 2.0, -1.0])
    y = (rng.uniform(size=4000) < 1 / (1 + np.exp(-x @ weights))).astype(float)
    module = load("calibrate")
    fitted = module.fit_logistic(x, y)
    assert fitted == pytest.approx(weights, abs=0.2)
    assert module.probability_wrong(x, fitted).mean() == pytest.approx(1 - y.mean(), abs=0.005)


def test_a_shift_between_images_is_measured_to_a_fraction_of_a_pixel(load):
    rng = np.random.default_rng(5)
    a = cv2.GaussianBlur(rng.normal(size=(120, 120, 2)).astype(np.float32), (0, 0), 2.0)
    b = cv2.warpAffine(a, np.float32([[1, 0, 1.4], [0, 1, -0.7]]), (120, 120), flags=cv2.INTER_CUBIC)
    shift = load("image_cases.shift")
    assert shift.shift_px(a, b, (60.0, 60.0), 61) == pytest.approx([1.4, -0.7], abs=0.06)
    assert shift.shift_px(a, b, (10.0, 60.0), 61) is None


def test_closure_tells_the_noise_from_the_shift(load):
    rng = np.random.default_rng(6)
    names = ["a", "b", "c", "d"]
    offset = {name: rng.normal(0, 1.0, (500, 2)) for name in names}
    shifts = {(a, b): offset[b] - offset[a] + rng.normal(0, 0.1, (500, 2)) for a, b in combinations(names, 2)}
    assert load("floor").closure_noise(shifts, names) == pytest.approx(0.1, rel=0.1)


def test_windows_lie_within_their_rows(load):
    floor = load("floor")
    rng = np.random.default_rng(7)
    a = floor.featured(cv2.GaussianBlur(rng.uniform(0, 255, (200, 160)), (0, 0), 2.0).astype(np.uint8), 1.0)
    b = cv2.warpAffine(a, np.float32([[1, 0, 1.0], [0, 1, 2.0]]), (160, 200))
    upper, whole = (floor.grid_shifts({"a": a, "b": b}, floor.Windows(rows, 41, 20))["a", "b"] for rows in ((0, 100), (0, 200)))
    assert 0 < len(upper) < len(whole)
    np.testing.assert_allclose(whole.mean(0), (1.0, 2.0), atol=0.1)


def test_registration_is_stated_in_metres_less_the_noise(load):
    rng = np.random.default_rng(8)
    names = ["a", "b", "c", "d"]
    offset = {name: rng.normal(0, (0.3, 0.1), (2000, 2)) for name in names}
    noisy = {(a, b): offset[b] - offset[a] + rng.normal(0, 0.2, (2000, 2)) for a, b in combinations(names, 2)}
    cells = [cell.strip() for cell in load("registration").row("here", noisy, noisy, 5.0).strip("|").split("|")]
    assert cells[:4] == ["here", "5", "2000", "6"]
    between = 5 * 2**0.5
    expected = (0.3 * between, 0.1 * between, 0.05**0.5 * between, 1.0)
    assert [float(c) for c in cells[4:]] == pytest.approx(expected, rel=0.1)


def test_flights_of_a_method_become_one_row(load):
    flights = load("flights")
    result = {"passed": True, "n_fixes": 3, "n_no_fix": 1, "availability": 0.5, "hmi": 0}
    one = flights.Flown(result, np.array([1.0, 2.0, np.nan]), np.array([3.0]), np.array([10.0, 20.0, 30.0]))
    two = flights.Flown({**result, "passed": False, "availability": 1.0}, np.array([6.0]), np.array([]), np.array([40.0]))
    cells = [cell.strip() for cell in flights.gain_row("here", "deep", [one, two]).strip("|").split("|")]
    assert cells[:5] == ["here", "deep", "1 of 2", "8", "75.0 %"]
    assert cells[5:] == ["2.00", "5.60", "3.00", "3.00", "75.0 %", "0", "25"]
    assert flights.GAIN_HEADER.count("|") == len(cells) + 1


def test_a_row_of_the_table_counts_refusals_and_far_answers(load, folder, tmp_path, asked):
    judged = load("image_cases.answers").answers(folder, "ncc", tmp_path / "store", "abc")
    far = replace(judged[0][0], fix=replace(FIX, place=GeoPoint(47.001, 9.0, 100.0), probability_wrong=0.01))
    figures = load("table").figures([*judged, (far, judged[0][1])], 0.05)
    assert figures["n"] == 6
    assert figures["within_5px_share"] == pytest.approx(3 / 6)
    assert (figures["accepted_right_share"], figures["accepted_far"]) == (0.0, 1)
    assert figures["refused_share"] == pytest.approx(5 / 6)
    assert load("table").row("t2", "gradient", figures).count("|") == load("table").HEADER.count("|")
    assert load("table").figures([], 0.05) == {"n": 0}


def test_claims_follow_the_coefficients_without_a_new_run(load, monkeypatch):
    answers = load("image_cases.answers")
    numbers = Evidence(0.5, 0.5, 0.6, 2.0, 0.9, 30.0, 25.0, 90.0, 0.8, 0.2, 0.2, 0.5, 0.5, 0.8, 0.6).numbers() | {
        "share": 0.9,
        "votes": 0.8,
        "p_wrong": 0.7,
        "looks": 1.0,
    }
    stored = CaseResult("c0", FIX, None, "", 3.5, numbers, 0.5)
    now = answers.judged_anew(stored, "deep")
    alone = probability_wrong(Evidence.from_numbers(numbers), DEEP_WEIGHTS)
    assert now.fix.probability_wrong == now.evidence["p_wrong"] == pytest.approx(1 - 0.9 * 0.8 * (1 - alone))
    again = answers.judged_anew(replace(stored, evidence=numbers | {"looks": 2.0}), "deep")
    alone = probability_wrong(Evidence.from_numbers(numbers), AGAIN_WEIGHTS)
    assert again.fix.probability_wrong == pytest.approx(1 - 0.9 * 0.8 * (1 - alone))
    monkeypatch.setitem(answers.WEIGHTS, "deep", (-50.0, *DEEP_WEIGHTS[1:]))
    assert answers.judged_anew(stored, "deep").fix.probability_wrong > 0.999
    assert answers.judged_anew(stored, "ncc") is stored
    nothing = replace(stored, fix=None)
    assert answers.judged_anew(nothing, "deep") is nothing
