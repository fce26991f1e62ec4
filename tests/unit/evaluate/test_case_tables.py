"""Tables of image cases and of their truth as people write them: columns twice, rows cut short, blanks, decimal commas."""

from __future__ import annotations

import csv

import pytest

from tests.unit.evaluate.test_image_cases import TRUTH_COLUMNS, write
from tests.unit.evaluate.test_image_cases import folder as folder  # noqa: PLC0414 - a fixture
from visloc_companion.errors import CasesError
from visloc_companion.evaluate.cases import BadCase, Case, read_cases, read_truth


def test_folders_that_are_none_are_errors(tmp_path):
    with pytest.raises(CasesError, match="cannot be read"):
        read_cases(tmp_path)
    (tmp_path / "cases.csv").write_text("id,frame\na,b\n")
    with pytest.raises(CasesError, match="ortho"):
        read_cases(tmp_path)
    (tmp_path / "truth.csv").write_text(",".join(TRUTH_COLUMNS) + ",gsd_m\na,0,0,0,0,0,0,nan\n")
    with pytest.raises(CasesError, match=r"truth\.csv, row 1: gsd_m is not finite.*remedy"):
        read_truth(tmp_path)
    (tmp_path / "truth.csv").write_text(",".join(TRUTH_COLUMNS) + "\na,north,0,0,0,0,0\n")
    with pytest.raises(CasesError, match="lat_deg"):
        read_truth(tmp_path)


def test_a_column_that_is_there_twice_is_refused(tmp_path, folder):
    """The last one was taken."""
    lines = (folder / "cases.csv").read_text().splitlines()
    (tmp_path / "cases.csv").write_text("\n".join([lines[0] + ", prior_lat_deg", lines[1] + ",46.9"]))
    with pytest.raises(CasesError, match=r"cases\.csv: has column prior_lat_deg more than once; remedy"):
        read_cases(tmp_path)
    (tmp_path / "truth.csv").write_text("id,lat_deg,lon_deg,yaw_deg,yaw_deg\nc0,47,5,9,10\n")
    with pytest.raises(CasesError, match=r"truth\.csv: has column yaw_deg more than once"):
        read_truth(tmp_path)


@pytest.mark.parametrize(("text", "given"), [("-0.2, 0.1 ,0 0", (-0.2, 0.1, 0.0, 0.0, 0.0)), ("-0.2,,0,0,0", None), ("0,", None)])
def test_a_coefficient_that_is_left_out_moves_no_other(tmp_path, folder, text, given):
    with (folder / "cases.csv").open(newline="") as stream:
        row = next(csv.DictReader(stream))
    write(tmp_path / "cases.csv", [row | {"distortion": text}])
    (case,) = read_cases(tmp_path)
    assert (case.camera.distortion if isinstance(case, Case) else None) == given
    assert isinstance(case, Case) or "distortion is not a number" in case.why


def test_rows_that_are_cut_short_are_bad_cases(tmp_path, folder):
    text = (folder / "cases.csv").read_text().splitlines()
    (tmp_path / "cases.csv").write_text("\n".join([text[0], text[1][:60]]))
    assert isinstance(read_cases(tmp_path)[0], BadCase)


def test_blanks_behind_names_and_values_mean_nothing(tmp_path, folder):
    """Of tables that are set in columns; each frame was missing, and a `solvable` no number."""
    for name in ("cases.csv", "truth.csv"):
        lines = (folder / name).read_text().splitlines()
        (tmp_path / name).write_text("\n".join(" ,".join(line.split(",")) + " " for line in lines))
    case, known = read_cases(tmp_path)[0], read_cases(folder)[0]
    assert isinstance(case, Case) and isinstance(known, Case)
    assert (case.case_id, case.frame.name, case.ortho.name) == ("c0 ", known.frame.name, known.ortho.name), (
        "ids come back as given"
    )
    assert case.prior == known.prior
    assert read_truth(tmp_path)["c0 "] == read_truth(folder)["c0"]


def test_rows_of_commas_alone_are_no_cases(tmp_path, folder):
    """Spreadsheets end a table with such rows."""
    for name in ("cases.csv", "truth.csv"):
        lines = (folder / name).read_text().splitlines()
        empty = "," * lines[0].count(",")
        (tmp_path / name).write_text("\n".join([lines[0], lines[1], empty, " " + empty, ""]))
    assert [case.case_id for case in read_cases(tmp_path)] == ["c0"]
    assert list(read_truth(tmp_path)) == ["c0"]


def test_rows_with_decimal_commas_are_bad_cases_and_blanks_at_their_end_are_none(tmp_path, folder):
    lines = (folder / "cases.csv").read_text().splitlines()
    columns, comma = lines[0].split(","), lines[1].split(",")
    comma[columns.index("id")], comma[columns.index("prior_h_m")] = "comma", "100,5"
    (tmp_path / "cases.csv").write_text("\n".join([lines[0], lines[1] + ",,", ",".join(comma)]))
    right, wrong = read_cases(tmp_path)
    assert isinstance(right, Case)
    assert isinstance(wrong, BadCase)
    assert "has more fields than there are columns" in wrong.why
    (tmp_path / "truth.csv").write_text("id,lat_deg,lon_deg,h_m,roll_deg,pitch_deg,yaw_deg\nc0,47,5,9,100,0,0,0\n")
    with pytest.raises(CasesError, match=r"truth\.csv, row 1: has more fields than there are columns \('0'\).*"):
        read_truth(tmp_path)


@pytest.mark.parametrize(
    ("column", "text", "why"),
    [
        ("fx_px", "1e308", "fx_px is too large: 1e+308"),
        ("fy_px", "1e-308", "fx_px and fy_px are no lens's: "),
        ("distortion", "1e308 0", "distortion is too large"),
        ("prior_h_m", "-1e300", "prior_h_m is too large: -1e+300"),
        ("prior_yaw_deg", "1e200", "prior_yaw_deg is too large"),
        ("prior_h_m", "1_0", "prior_h_m is not a number: '1_0'"),
        ("prior_h_m", "1,5", "prior_h_m is not a number: '1,5' (write decimals with a point)"),
    ],
)
def test_numbers_that_nothing_can_be_reckoned_with_are_named(tmp_path, folder, column, text, why):
    """The reason of the case was `ZeroDivisionError: float division by zero (plan.py:185)`, and 1_0 was ten."""
    with (folder / "cases.csv").open(newline="") as stream:
        row = next(csv.DictReader(stream))
    write(tmp_path / "cases.csv", [row | {column: text}])
    (case,) = read_cases(tmp_path)
    assert isinstance(case, BadCase) and case.why.startswith(why)
