from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.errors import CasesError
from visloc_companion.evaluate.case_ids import require_distinct, require_truth_of
from visloc_companion.evaluate.cases import COLUMNS, TRUTH_COLUMNS, Case, read_cases, read_truth
from visloc_companion.evaluate.clouds.cloud_cases import read_cloud_cases, read_cloud_truth
from visloc_companion.evaluate.images.image import evaluate_image

CASE = "a,f.png,o.tif,,100,100,50,50,,47,8,100,0,0,0,10,5,1,0.1"
IDENTITY = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"


def test_every_case_has_an_id_of_its_own(tmp_path: Path) -> None:
    require_distinct(["a", "b"], tmp_path)
    with pytest.raises(CasesError, match="id 'a' is there 2 times"):
        require_distinct(["a", "b", "a"], tmp_path)
    with pytest.raises(CasesError, match="holds no case"):
        require_distinct([], tmp_path)


def test_truth_tells_of_the_cases(tmp_path: Path) -> None:
    require_truth_of(["a", "b"], {"b": 1}, tmp_path)
    require_truth_of(["a"], {}, tmp_path)
    with pytest.raises(CasesError, match="tells of none of the cases \\(it has 'A', they have 'a'\\)"):
        require_truth_of(["a"], {"A": 1}, tmp_path)


def images(folder: Path, cases: list[str], truth: list[str], gap: str = ",") -> Path:
    (folder / "cases.csv").write_text("\n".join([gap.join(COLUMNS), *(case.replace(",", gap) for case in cases)]))
    (folder / "truth.csv").write_text("\n".join([gap.join([*TRUTH_COLUMNS, "gsd_m", "solvable"]), *truth]))
    return folder


def test_columns_may_be_set_off_by_blanks_as_the_interface_writes_them(tmp_path: Path) -> None:
    folder = images(tmp_path, [CASE], ["a, 47, 8, 100, 0, 0, 0, 0.5, False"], gap=", ")
    case, truth = read_cases(folder)[0], read_truth(folder)["a"]
    assert isinstance(case, Case)
    assert (case.frame.name, case.dsm, truth.gsd_m, truth.solvable) == ("f.png", None, 0.5, False)


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        (["a,47,8,100,0,0,0,1,1", "a,47,9,100,0,0,0,1,1"], "id 'a' is there 2 times"),
        (["b,47,8,100,0,0,0,1,1"], "tells of none of the cases"),
        ([], "holds no case"),
        (["a,147,8,100,0,0,0,1,1"], "row 1: truth is not on earth"),
        (["a,47,8,100,0,0,0,1,1", "b,47,8,nan,0,0,0,1,1"], "row 2: h_m is not finite"),
        (["a,47,8,100,0,0,0,five,1"], "row 1: gsd_m is not a number"),
        (["a,47,8,100,0,0,0,1,maybe"], "row 1: solvable is neither 0 nor 1"),
        (["a,8,47,100,0,0,0,1,1"], "id a: latitude and longitude are exchanged: it lies 5"),
        (["a,-47,8,100,0,0,0,1,1"], "id a: it is the truth of another place: it lies 104"),
    ],
)
def test_a_wrong_truth_of_images_is_named(tmp_path: Path, truth: list[str], words: str) -> None:
    with pytest.raises(CasesError, match=r"truth\.csv") as caught:
        evaluate_image(images(tmp_path, [CASE], truth), "gradient")
    assert words in str(caught.value)


def test_a_case_without_an_answer_may_be_of_elsewhere(tmp_path: Path) -> None:
    document, _ = evaluate_image(images(tmp_path, [CASE], ["a,8,47,100,0,0,0,1,0"]), "gradient")
    assert document["cases"][0]["status"] == "no_fix"


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        ("b,48.5,8,100,0,0,0,1,1", "id b: it is the truth of another place: it lies 167 km from its prior; a fix near the prior"),
        ("b,8,47,100,0,0,0,1,1", "id b: latitude and longitude are exchanged: it lies 5"),
    ],
)
def test_one_truth_that_lies_elsewhere_costs_no_answers(tmp_path: Path, truth: str, words: str) -> None:
    """The prior may be what is elsewhere, and only the summary rests on a truth."""
    cases, near = [CASE, f"b{CASE[1:]}", f"c{CASE[1:]}"], ["a,47,8,100,0,0,0,1,1", "c,8,47,100,0,0,0,1,0"]
    document, _ = evaluate_image(images(tmp_path, cases, [*near, truth]), "gradient")
    assert [case["id"] for case in document["cases"]] == ["a", "b", "c"]
    (warning,) = document["warnings"]
    assert words in warning and "truth.csv" in warning
    assert document["summary"]["n_solvable"] == 2, "it is judged all the same"


def test_a_table_of_another_encoding_is_told_so(tmp_path: Path) -> None:
    folder = images(tmp_path, [CASE], [])
    (folder / "cases.csv").write_text((folder / "cases.csv").read_text(), encoding="utf-16")
    with pytest.raises(CasesError, match=r"cases\.csv: cannot be read: .*; remedy: write UTF-8 CSV, separated by commas"):
        read_cases(folder)


def test_ids_of_clouds_are_distinct_as_well(tmp_path: Path) -> None:
    (tmp_path / "cases.json").write_text('[{"id": "a"}, {"id": "a"}]')
    (tmp_path / "truth.json").write_text("[" + ",".join([f'{{"id": "a", "T_reference_source": {IDENTITY}}}'] * 2) + "]")
    with pytest.raises(CasesError, match="is there 2 times"):
        read_cloud_cases(tmp_path)
    with pytest.raises(CasesError, match="is there twice"):
        read_cloud_truth(tmp_path)
