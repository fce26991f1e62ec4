"""Frames of another size than their calibration is for: a crop is placed off by what was cut off, and sure of it."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from tests.unit.evaluate.test_image_cases import folder as folder  # noqa: PLC0414 - a fixture
from tests.unit.evaluate.test_image_cases import write
from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.errors import Reason
from visloc_companion.evaluate.cases import BadCase, read_cases
from visloc_companion.evaluate.images.image import evaluate_image


@pytest.fixture
def mixed(folder: Path, tmp_path: Path) -> tuple[Path, list[dict[str, str]]]:
    """Three whole frames and one that somebody cut to another shape."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    (tmp_path / "truth.csv").unlink()
    with (tmp_path / "cases.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))[:3]
    picture = cv2.imread(str(tmp_path / "f0.png"))
    assert picture is not None
    cv2.imwrite(str(tmp_path / "wide.png"), picture[15:85])
    rows = [*rows, rows[0] | {"id": "cut", "frame": "wide.png"}]
    write(tmp_path / "cases.csv", rows)
    return tmp_path, rows


def test_frames_of_several_sizes_under_one_calibration_are_told(mixed: tuple[Path, list[dict[str, str]]]) -> None:
    document, _ = evaluate_image(mixed[0], "gradient")
    assert document["warnings"] == [
        "cases.csv: one calibration (fx_px 100, fy_px 100, cx_px 59.5, cy_px 49.5) has frames of several sizes: "
        "120 x 100 px (3, as c0), 120 x 70 px (1, as cut); it is of one of them, and fixes of the others lie off; "
        "remedy: state its width_px and height_px in columns of cases.csv"
    ]
    done = CliRunner().invoke(evaluate_app, ["image", str(mixed[0]), "--method", "gradient"])
    assert (done.exit_code, done.stderr.count("WARNING: cases.csv: one calibration")) == (0, 1)


def test_with_the_size_stated_those_of_another_are_refused(mixed: tuple[Path, list[dict[str, str]]]) -> None:
    cases, rows = mixed
    write(cases / "cases.csv", [row | {"width_px": "120", "height_px": "100"} for row in rows])
    document, results = evaluate_image(cases, "gradient")
    assert "warnings" not in document
    assert [result.fix is not None for result in results] == [True, True, True, False]
    assert results[3].reason is Reason.BAD_INPUT
    assert results[3].detail.endswith(
        "wide.png: 120 x 70 px, calibrated for 120 x 100; remedy: give the frame as it was taken, or its own calibration"
    )
    own = rows[3] | {"cy_px": "34.5"}
    write(cases / "cases.csv", [*rows[:3], own])
    assert "warnings" not in evaluate_image(cases, "gradient")[0], "with its own calibration there is nothing to tell"


@pytest.mark.parametrize(("width", "height"), [("120", ""), ("120", "0"), ("12.5", "100"), ("wide", "100")])
def test_a_size_that_is_none_is_a_bad_case(mixed: tuple[Path, list[dict[str, str]]], width: str, height: str) -> None:
    cases, rows = mixed
    write(cases / "cases.csv", [rows[0] | {"width_px": width, "height_px": height}])
    (case,) = read_cases(cases)
    assert isinstance(case, BadCase)
    assert "_px" in case.why
