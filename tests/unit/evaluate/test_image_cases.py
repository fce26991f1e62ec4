from __future__ import annotations

import csv
import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from typer.testing import CliRunner

from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.errors import ConfigError, ModelError, Reason
from visloc_companion.evaluate.cases import COLUMNS, Case, read_cases, read_truth
from visloc_companion.evaluate.images.image import evaluate_image, run_case
from visloc_companion.evaluate.images.image_metrics import CaseResult, case_error, summarise
from visloc_companion.evaluate.images.map_sigma import MapSigma
from visloc_companion.localise.registry import METHODS, ON_FEATURES
from visloc_companion.localise.runtime import NetworkChoice

TRUTH_COLUMNS = ("id", "lat_deg", "lon_deg", "h_m", "roll_deg", "pitch_deg", "yaw_deg")
LAT, LON = 47.0, 9.0


def texture() -> np.ndarray:
    rng = np.random.default_rng(4)
    image = np.full((300, 320), 110, np.uint8)
    for _ in range(350):
        box = cv2.boxPoints((tuple(rng.uniform(0, 310, 2)), tuple(rng.uniform(4, 40, 2)), rng.uniform(0, 180)))
        cv2.fillPoly(image, [np.int32(box)], int(rng.uniform(30, 220)))
    return cv2.GaussianBlur(image, (0, 0), 0.8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A map of 1 m/px in UTM 32N centred on its meridian (true north is up) and frames cut from it: nadir, yaw 0, 100 m up."""
    root = tmp_path_factory.mktemp("cases")
    image = texture()
    easting, northing = 500000.0, 5205353.0
    with rasterio.open(
        root / "map.tif",
        "w",
        driver="GTiff",
        width=320,
        height=300,
        count=1,
        dtype="uint8",
        crs="EPSG:32632",
        transform=Affine(1, 0, easting - 160, 0, -1, northing + 150),
    ) as out:
        out.write(image, 1)
    from pyproj import Transformer

    to_geo = Transformer.from_crs(32632, 4326, always_xy=True)
    rows, truths = [], []
    for k, (row, col) in enumerate([(150, 160), (120, 190), (170, 120)]):
        cv2.imwrite(str(root / f"f{k}.png"), image[row - 50 : row + 50, col - 60 : col + 60])
        lon, lat = to_geo.transform(easting - 160 + col, northing + 150 - row)
        prior_lon, prior_lat = to_geo.transform(easting - 160 + col + 6, northing + 150 - row - 4)
        rows.append(
            dict.fromkeys(COLUMNS, "0")
            | {
                "id": f"c{k}",
                "frame": f"f{k}.png",
                "ortho": "map.tif",
                "dsm": "",
                "distortion": "",
                "fx_px": "100",
                "fy_px": "100",
            }
            | {"cx_px": "59.5", "cy_px": "49.5", "prior_lat_deg": repr(prior_lat), "prior_lon_deg": repr(prior_lon)}
            | {"prior_h_m": "101", "prior_yaw_deg": "1", "sigma_horizontal_m": "6", "sigma_h_m": "2", "sigma_yaw_deg": "1.5"}
            | {"sigma_tilt_deg": "0.1"}
        )
        truths.append(dict(zip(TRUTH_COLUMNS, (f"c{k}", repr(lat), repr(lon), "100", "0", "0", "0"), strict=True)))
    bad = [
        rows[0] | {"id": "no_frame", "frame": "absent.png"},
        rows[0] | {"id": "no_map", "ortho": "absent.tif"},
        rows[0] | {"id": "not_a_number", "prior_h_m": "high"},
        rows[0] | {"id": "infinite", "sigma_h_m": "inf"},
        rows[0] | {"id": "far", "prior_lat_deg": "-33.0"},
        rows[0] | {"id": "text_for_frame", "frame": "cases.csv"},
        rows[0] | {"id": "off_earth", "prior_lat_deg": "95"},
        rows[0] | {"id": "long_distortion", "distortion": "1 2 3 4 5 6"},
        rows[0] | {"id": "short_fisheye", "distortion_model": "fisheye", "distortion": "0 0"},
        rows[0] | {"id": "unknown_lens", "distortion_model": "equidistant", "distortion": "0 0 0 0"},
        rows[0] | {"id": "folded_fisheye", "distortion_model": "fisheye", "distortion": "-1.5 0 0 0"},
        rows[0] | {"id": "no_focal_length", "fx_px": "0"},
        rows[0] | {"id": "endless_sigma", "sigma_horizontal_m": "1e200"},
        rows[0] | {"id": "no_name", "frame": "a\0.png"},
    ]
    write(root / "cases.csv", [{"distortion_model": ""} | row for row in rows + bad])
    write(root / "truth.csv", truths)
    return root


def write(path: Path, rows: list[dict[str, str]]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture(scope="module")
def document(folder):
    return evaluate_image(folder, "gradient")[0]


def test_good_cases_are_fixed_and_bad_ones_declined_with_a_reason(document):
    by_id = {case["id"]: case for case in document["cases"]}
    assert [by_id[f"c{k}"]["status"] for k in range(3)] == ["fix"] * 3
    reasons = {name: case["reason"] for name, case in by_id.items() if case["status"] == "no_fix"}
    assert reasons == {
        "no_frame": "bad_frame",
        "no_map": "bad_input",
        "not_a_number": "bad_input",
        "infinite": "bad_input",
        "far": "outside_map",
        "text_for_frame": "bad_frame",
        "off_earth": "bad_input",
        "long_distortion": "bad_input",
        "short_fisheye": "bad_input",
        "unknown_lens": "bad_input",
        "folded_fisheye": "bad_input",
        "no_focal_length": "bad_input",
        "endless_sigma": "bad_input",
        "no_name": "bad_input",
    }
    assert all(case["lat_deg"] is None for case in by_id.values() if case["status"] == "no_fix")


def test_document_has_the_agreed_fields_and_is_strict_json(document):
    json.loads(json.dumps(document, allow_nan=False))
    assert list(document) == ["schema", "method", "environment", "cases", "summary"]
    assert set(document["cases"][0]) == {
        *("id", "status", "reason", "lat_deg", "lon_deg", "h_m", "roll_deg", "pitch_deg", "yaw_deg", "cov_ne_m2"),
        *("sigma_h_m", "protection_level_m", "probability_wrong", "elapsed_ms"),
    }
    fix = document["cases"][0]
    largest = math.sqrt(max(np.linalg.eigvalsh(fix["cov_ne_m2"])))
    assert fix["protection_level_m"] == pytest.approx(4.80 * largest, rel=1e-3)


def test_summary_tells_errors_against_the_truth(document):
    summary = document["summary"]
    assert (summary["n"], summary["n_fix"], summary["n_with_truth"]) == (17, 3, 3)
    assert summary["error_m"]["max"] < 0.5
    assert summary["error_px"]["max"] == pytest.approx(summary["error_m"]["max"], rel=0.01)
    assert summary["within_5px_share"] == 1.0
    assert summary["wrong_and_accepted"] == 0
    assert summary["altitude_error_m"]["max"] < 1.0
    assert summary["heading_error_deg"]["max"] < 0.3
    assert summary["map_side_ms"]["mean"] > 0


def test_what_a_case_claims_includes_the_maps_own_error(folder):
    exact, off = (
        evaluate_image(folder, "gradient", limit=1, map_sigma=MapSigma(*sigmas))[0]["cases"][0]
        for sigmas in ((0, 0, 0), (3, 2, 4))
    )
    added = np.array(off["cov_ne_m2"]) - np.array(exact["cov_ne_m2"])
    np.testing.assert_allclose(added, np.diag([9, 4]), atol=1e-4)
    assert off["sigma_h_m"] == pytest.approx(math.hypot(exact["sigma_h_m"], 4), rel=1e-4)
    assert off["protection_level_m"] > exact["protection_level_m"]


def test_two_processes_give_the_same_as_one(folder, document):
    again = evaluate_image(folder, "gradient", jobs=2, limit=2)[0]
    for a, b in zip(again["cases"], document["cases"], strict=False):
        assert a["lat_deg"] == pytest.approx(b["lat_deg"], abs=1e-8)


def test_a_killed_worker_does_not_end_the_run(folder, document, dying_pool):
    cases = evaluate_image(folder, "gradient", jobs=2)[0]["cases"]
    assert [case["id"] for case in cases] == [case["id"] for case in document["cases"]]


def test_a_fault_over_one_case_costs_the_others_nothing(folder, document, monkeypatch):
    from visloc_companion.evaluate.images import image

    made = image.make_localiser
    first = read_cases(folder)[0].case_id

    def faulty(*given, **more):
        localiser = made(*given, **more)
        answer, asked = localiser.localise, len(calls)
        calls.append(first)
        localiser.localise = answer if asked else lambda *_: 1 / 0
        return localiser

    calls = []
    monkeypatch.setattr(image, "make_localiser", faulty)
    again, results = evaluate_image(folder, "gradient")
    assert again["cases"][0]["status"] == "no_fix" and again["cases"][0]["reason"] == "bad_input"
    assert results[0].detail.startswith("ZeroDivisionError: division by zero (test_image_cases.py:")
    assert [case["status"] for case in again["cases"][1:]] == [case["status"] for case in document["cases"][1:]]


def test_wrong_fixes_and_unsolvable_cases_count_as_wrong_and_accepted(folder):
    case = read_cases(folder)[0]
    assert isinstance(case, Case)
    result = run_case(case, "gradient")
    truth = read_truth(folder)["c0"]
    error = case_error(result, truth)
    assert error is not None
    assert not error.wrong
    for other in (replace(truth, solvable=False), replace(truth, lat_deg=truth.lat_deg + 1e-4)):
        assert summarise([result], {"c0": other})["wrong_and_accepted"] == 1
    assert case_error(CaseResult("c0", None, Reason.NO_MATCH), truth) is None


@pytest.mark.parametrize("known", [("h_m",), ("h_m", "roll_deg", "pitch_deg", "yaw_deg"), ()])
@pytest.mark.parametrize("empty", [False, True])
def test_a_truth_need_not_know_height_and_attitude(folder, tmp_path, known, empty):
    """A photo's place is often known where its attitude is not: what is not known is judged by nothing."""
    columns = [c for c in TRUTH_COLUMNS if empty or c in ("id", "lat_deg", "lon_deg", *known)]
    whole = list(csv.DictReader((folder / "truth.csv").read_text().splitlines()))
    truths = [{c: row[c] if c in ("id", "lat_deg", "lon_deg", *known) else "" for c in columns} for row in whole]
    here = tmp_path / "cases"
    shutil.copytree(folder, here)
    write(here / "truth.csv", truths)
    out, report = tmp_path / "out.json", tmp_path / "report"
    result = CliRunner().invoke(
        evaluate_app, ["image", str(here), "--limit", "3", "--json", str(out), "--report", str(report), "--method", "gradient"]
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(out.read_text())["summary"]
    assert summary["n_with_truth"] == summary["n_fix"] == 3
    assert summary["error_m"]["max"] < 1.0
    of_height = ("altitude_error_m", "altitude_error_percent")
    assert [summary[name] is not None for name in of_height] == ["h_m" in known] * 2
    assert (summary["rms_error_over_sigma"]["height"] is not None) == ("h_m" in known)
    assert [summary[name] is not None for name in ("heading_error_deg", "tilt_error_deg")] == ["yaw_deg" in known] * 2
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", (report / "report.html").read_text()))


def test_command_writes_json_and_report(folder, tmp_path):
    report = tmp_path / "report"
    out = report / "out.json"
    result = CliRunner().invoke(
        evaluate_app, ["image", str(folder), "--limit", "1", "--json", str(out), "--report", str(report), "--method", "ncc"]
    )
    assert result.exit_code == 0, result.output
    assert json.loads(out.read_text())["method"] == "ncc"
    page = (report / "report.html").read_text()
    assert "c0" in page
    assert "http" not in page


def test_the_command_says_what_is_wrong_with_which_case(folder):
    said = CliRunner().invoke(evaluate_app, ["image", str(folder), "--method", "ncc"]).stderr
    for words in (
        f"no_frame: {folder / 'absent.png'}: is missing, cut off or no image; remedy: ",
        f"no_map: {folder / 'absent.tif'}: there is no such file; remedy: ",
        "not_a_number: prior_h_m is not a number: 'high'",
        "off_earth: prior is not on earth",
    ):
        assert words in said
    assert "far:" not in said, "what is outside the map is an answer"


def test_methods_are_listed_and_unknown_ones_refused(folder):
    listed = CliRunner().invoke(evaluate_app, ["image", "--list-methods"])
    assert listed.output.split() == list(METHODS) and {"gradient", "deep", "ncc", "keypoint"} <= set(METHODS)
    refused = CliRunner().invoke(evaluate_app, ["image", str(folder), "--method", "psychic"])
    assert isinstance(refused.exception, ConfigError)
    assert isinstance(CliRunner().invoke(evaluate_app, ["image"]).exception, ConfigError)


def test_a_result_that_could_not_be_written_is_refused_before_the_work(folder, tmp_path):
    command = ["image", str(folder), "--method", "gradient", "--json", str(tmp_path / "none" / "out.json")]
    refused = CliRunner().invoke(evaluate_app, command)
    assert isinstance(refused.exception, ConfigError) and "its folder does not exist" in str(refused.exception)


def test_a_report_that_could_not_be_written_is_refused_before_the_work(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("visloc_companion.evaluate.images.image.evaluate_image", None)
    (tmp_path / "report").write_text("a file")
    refused = CliRunner().invoke(evaluate_app, ["image", str(folder), "--report", str(tmp_path / "report")])
    assert isinstance(refused.exception, ConfigError) and "writable folder for --report" in str(refused.exception)


@pytest.mark.shared
def test_two_years_of_naip_agree(shared_data, tmp_path):
    tool = shared_data.parent / "tools" / "make_image_cases.py"
    subprocess.run(
        [sys.executable, str(tool), str(shared_data / "naip"), str(tmp_path), "--n", "8", "--seed", "5", "--rows", "400:"],
        check=True,
    )
    summary = evaluate_image(tmp_path, "gradient")[0]["summary"]
    assert summary["wrong_and_accepted"] == 0
    assert summary["n_fix"] >= 6
    assert summary["error_px"]["mean"] < 1.5


@pytest.mark.parametrize("method", list(ON_FEATURES))
def test_a_network_that_is_named_is_used_and_stated(folder, network, method):
    chosen = NetworkChoice(network, ("tensorrt", "cpu"), threads=1)
    document, results = evaluate_image(folder, method, limit=2, network=chosen)
    assert document["environment"]["provider"] == "cpu"
    assert document["environment"]["network"].startswith("tiny-") and "passed over tensorrt" in document["environment"]["network"]
    assert all(result.reason is not Reason.BAD_INPUT for result in results)


def test_methods_without_a_network_state_none(document):
    assert document["environment"]["provider"] == "cpu" and document["environment"]["network"] is None


def test_a_network_that_cannot_be_used_is_said_before_any_case(folder, tmp_path):
    with pytest.raises(ModelError, match=r"manifest.json: there is no such file"):
        evaluate_image(folder, next(iter(ON_FEATURES)), network=NetworkChoice(tmp_path / "nowhere"))
    wrong = CliRunner().invoke(evaluate_app, ["image", str(folder), "--method", "gradient", "--provider", "vulkan"])
    assert isinstance(wrong.exception, ConfigError) and "--provider: unknown provider 'vulkan'" in str(wrong.exception)


@pytest.mark.parametrize("method", ["gradient", "keypoint", "ncc", "mi"])
def test_errors_of_height_are_shares_of_that_above_the_ground(folder, tmp_path, method):
    """Expected: over ground 500 m above sea level 1 m of 100 is a hundredth, whatever the method says of its search."""
    with rasterio.open(folder / "map.tif") as ortho:
        profile = ortho.profile | {"dtype": "float32"}
    with rasterio.open(tmp_path / "dsm.tif", "w", **profile) as out:
        out.write(np.full((profile["height"], profile["width"]), 500, np.float32), 1)
    case = next(case for case in read_cases(folder) if case.case_id == "c0")
    place = replace(case.prior.place, h_amsl_m=case.prior.place.h_amsl_m + 500)
    raised = replace(case, dsm=tmp_path / "dsm.tif", prior=replace(case.prior, place=place))
    result = run_case(raised, method, max_probability_wrong=1.0)
    truth = replace(read_truth(folder)["c0"], h_m=600.0)
    error = case_error(result, truth)
    assert error is not None
    assert error.h_percent == pytest.approx(error.h_m, rel=0.05)
    assert run_case(replace(raised, frame=folder / "absent.png"), method).fix is None
