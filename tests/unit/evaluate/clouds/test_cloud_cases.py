from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from visloc_companion.cli import evaluate_cloud as evaluate_cloud_command
from visloc_companion.cli.evaluate import evaluate_app
from visloc_companion.errors import CasesError, ConfigError, Reason
from visloc_companion.evaluate.clouds import cloud as evaluated
from visloc_companion.evaluate.clouds.cloud import evaluate_cloud
from visloc_companion.evaluate.clouds.cloud_cases import BadCloudCase, CloudCase, read_cloud_cases, read_cloud_truth
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.registry import DEFAULT_METHOD, METHODS
from visloc_companion.localise.registration.similarity import about, from_origin

SIGMAS = {
    "sigma_horizontal_m": 10.0,
    "sigma_vertical_m": 3.0,
    "sigma_yaw_deg": 3.0,
    "sigma_tilt_deg": 0.3,
    "sigma_scale": 0.01,
}
SHIFT = np.array([3.0, -2.0, 0.5])
FAR_ORIGIN = np.array([5e5, 5.2e6, 300.0])


class Means:
    """Answers the shift between the means, claims 1 m and a probability of 1 % for shifts below 4 m, 60 % above."""

    def __init__(self, max_probability_wrong: float = 0.05) -> None:
        self.max_probability_wrong = max_probability_wrong

    def __call__(self, source: np.ndarray, reference: np.ndarray, prior: RegistrationPrior) -> Registered | NotRegistered:
        assert prior.sigma_yaw_rad == pytest.approx(np.radians(3.0))
        assert np.abs(reference).max() < 2000, "clouds are moved to the origin"
        if len(source) < 50:
            return NotRegistered(Reason.TOO_FEW_FEATURES, "few", (("points", float(len(source))),))
        T = np.eye(4)
        T[:3, 3] = reference.mean(0) - source.mean(0)
        p = 0.01 if np.linalg.norm(T[:3, 3]) < 4.0 else 0.6
        if p > self.max_probability_wrong:
            return NotRegistered(Reason.AMBIGUOUS, f"doubted: {p}", (("peak", 0.7),))
        return Registered(T, np.diag([1.0, 4.0, 0.25]), 0.01, 0.001, p, (("peak", 0.7),))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two cases that fit (one in far coordinates), one 30 m off, one that the method declines, and what cannot be read."""
    cloud = np.random.default_rng(1).uniform(-30, 30, (400, 3)) * [1, 1, 0.1]
    for name, points in (("a", cloud), ("far", cloud + FAR_ORIGIN), ("few", cloud[:20])):
        np.savez_compressed(tmp_path / f"{name}_source.npz", points=points - SHIFT)
        np.savez_compressed(tmp_path / f"{name}_reference.npz", points=points)
    np.savez_compressed(tmp_path / "off_reference.npz", points=cloud + np.array([30.0, 0, 0]))
    np.savez_compressed(tmp_path / "nan.npz", points=np.full((60, 3), np.nan))
    entry = {"source": "a_source.npz", "reference": "a_reference.npz", **SIGMAS}
    elsewhere = {"source": "far_source.npz", "reference": str(tmp_path / "far_reference.npz")}
    cases = [
        entry | {"id": "town_A_00"},
        entry | elsewhere | {"id": "town_A_01", "sigma_growth_m": 1.5},
        entry | {"id": "wood_B_00", "reference": "off_reference.npz"},
        entry | {"id": "wood_B_01", "source": "few_source.npz"},
        entry | {"id": "unknown", "source": "nan.npz"},
        entry | {"id": "absent", "reference": "absent.laz"},
        entry | {"id": "text", "sigma_scale": "wide"},
        entry | {"id": "negative", "sigma_yaw_deg": -1.0},
        entry | {"id": "endless", "sigma_vertical_m": float("inf")},
        entry | {"id": "nameless", "source": None},
        {"id": "nothing"},
        7,
        entry | {"id": "beyond_floats", "sigma_scale": 10**400},
        entry | {"id": "no_name", "source": "a\0.npz"},
    ]
    (tmp_path / "cases.json").write_text(json.dumps(cases))
    T = np.eye(4)
    T[:3, 3] = SHIFT
    truth = [
        {"id": f"{name}", "cloud": "x", "T_reference_source": T.tolist()} for name in ("town_A_00", "town_A_01", "wood_B_00")
    ]
    (tmp_path / "truth.json").write_text(json.dumps([*truth, truth[0] | {"id": "wood_B_01"}]))
    return tmp_path


@pytest.fixture(autouse=True)
def simple_method(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "means", Means)


def test_every_case_is_answered_or_refused_with_a_reason(folder: Path) -> None:
    document = evaluate_cloud(folder, "means")[0]
    json.loads(json.dumps(document, allow_nan=False))
    assert list(document)[:2] == ["schema", "method"] and document["environment"]["numpy"] == np.__version__
    by_id = {case["id"]: case for case in document["cases"]}
    assert {name: case["reason"] for name, case in by_id.items() if case["status"] == "no_fix"} == {
        "wood_B_00": "no_match",
        "wood_B_01": "too_few_features",
        **dict.fromkeys(("unknown", "absent", "text", "negative", "endless", "nameless", "nothing", "entry12"), "bad_input"),
        **dict.fromkeys(("beyond_floats", "no_name"), "bad_input"),
    }
    assert set(by_id["unknown"]) == {
        *("id", "status", "reason", "T_reference_source", "sigma_horizontal_m", "sigma_vertical_m"),
        *("protection_level_m", "probability_wrong", "elapsed_ms"),
    }
    assert by_id["wood_B_00"]["T_reference_source"] is None
    fix = by_id["town_A_00"]
    np.testing.assert_allclose(fix["T_reference_source"], np.vstack([np.c_[np.eye(3), SHIFT], [0, 0, 0, 1]]), atol=1e-9)
    assert fix["sigma_horizontal_m"] == pytest.approx(2.5**0.5) and fix["sigma_vertical_m"] == 0.5
    assert fix["protection_level_m"] == pytest.approx(4.80 * 2.0, rel=1e-3)
    assert fix["elapsed_ms"] > 0 and fix["reason"] is None


def test_a_similarity_of_far_coordinates_is_about_their_own_zero(folder: Path) -> None:
    case = next(c for c in evaluate_cloud(folder, "means")[0]["cases"] if c["id"] == "town_A_01")
    np.testing.assert_allclose(np.array(case["T_reference_source"])[:3, 3], SHIFT, atol=1e-6)
    T = np.eye(4)
    T[:3, :3] = 1.02 * np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    moved = from_origin(T, FAR_ORIGIN)
    point = FAR_ORIGIN + np.array([7.0, 8.0, 9.0])
    np.testing.assert_allclose(moved[:3, :3] @ point + moved[:3, 3], FAR_ORIGIN + T[:3, :3] @ [7.0, 8.0, 9.0], atol=1e-6)


def test_summary_counts_refused_cases_as_not_within(folder: Path) -> None:
    document, results = evaluate_cloud(folder, "means")
    summary = document["summary"]
    assert (summary["n"], summary["n_fix"], summary["n_with_truth"]) == (14, 2, 4)
    assert summary["mtre_m"]["max"] < 1e-6
    assert summary["within_1m_share"] == 0.5 and summary["within_5m_of_fixes_share"] == 1.0
    assert summary["far_and_accepted"] == 0
    assert summary["answers"]["mtre_m"]["max"] == pytest.approx(30.0)
    assert summary["reliability"]["separation"] == 1.0, "the doubted answer is judged although it is refused"
    assert {name: group["n_with_truth"] for name, group in summary["by_place"].items()} == {"town": 2, "wood": 2}
    assert [r.detail for r in results if r.case_id == "wood_B_00"] == ["wrong with a probability of 0.600"]
    everything = evaluate_cloud(folder, "means", max_probability_wrong=1.0)[0]["summary"]
    assert (everything["n_fix"], everything["far_and_accepted"], everything["wrong_and_accepted"]) == (3, 1, 1)


def test_a_fault_over_one_case_costs_the_others_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    answer = Means.__call__

    def faulty(self: Means, source: np.ndarray, *rest: object) -> object:
        asked.append(1)
        return answer(self, source, *rest) if len(asked) > 1 else asked[1]

    monkeypatch.setattr(Means, "__call__", faulty)
    results = evaluate_cloud(folder, "means", max_probability_wrong=1.0)[1]
    faults = [r for r in results if r.detail.startswith("IndexError: list index out of range (test_cloud_cases.py:")]
    assert len(faults) == 1 and faults[0].fix is None and faults[0].reason is Reason.BAD_INPUT
    assert sum(r.fix is not None for r in results) == 2


@pytest.mark.parametrize("suffix", ["npz", "laz"])
def test_a_file_that_cannot_even_be_looked_for_costs_its_case_alone(folder: Path, suffix: str) -> None:
    """A name that no file can have; so is one in a folder that this user may not enter."""
    entries = json.loads((folder / "cases.json").read_text())
    entries[1]["reference"] = f"{300 * 'x'}.{suffix}"
    (folder / "cases.json").write_text(json.dumps(entries))
    document, results = evaluate_cloud(folder, "means")
    assert len(results) == len(entries)
    assert [results[1].reason, results[1].detail.startswith(str(folder))] == [Reason.BAD_INPUT, True]
    assert "cannot be read: " in results[1].detail
    assert document["cases"][1]["status"] == "no_fix"


def test_every_readable_case_is_registered_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    answer = Means.__call__

    def counted(self: Means, source: np.ndarray, *rest: object) -> object:
        asked.append(len(source))
        return answer(self, source, *rest)

    monkeypatch.setattr(Means, "__call__", counted)
    evaluate_cloud(folder, "means")
    assert sorted(asked) == [20, 400, 400, 400]


def test_without_truth_there_are_counts_only(folder: Path) -> None:
    (folder / "truth.json").unlink()
    summary = evaluate_cloud(folder, "means", limit=2)[0]["summary"]
    assert list(summary) == ["n", "n_fix", "fix_share", "reasons", "elapsed_ms"] and summary["n"] == 2


def test_a_killed_process_does_not_end_the_run(folder: Path, dying_pool: None) -> None:
    done: list[int] = []
    cases = evaluate_cloud(folder, "means", jobs=2, progress=lambda k, n: done.append(k))[0]["cases"]
    assert [case["id"] for case in cases][:2] == ["town_A_00", "town_A_01"] and done == list(range(1, 15))


def test_processes_of_their_own_give_the_same(folder: Path) -> None:
    one, two = (evaluate_cloud(folder, "gicp", jobs=jobs, limit=2, max_probability_wrong=1.0)[0]["cases"] for jobs in (1, 2))
    assert [case["T_reference_source"] for case in one] == [case["T_reference_source"] for case in two]


def test_a_byte_order_mark_is_no_fault(folder: Path, tmp_path: Path) -> None:
    """Windows PowerShell and Excel write one."""
    for name in ("cases.json", "truth.json"):
        (tmp_path / name).write_text((folder / name).read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert [case.case_id for case in read_cloud_cases(tmp_path)] == [case.case_id for case in read_cloud_cases(folder)]
    assert read_cloud_truth(tmp_path).keys() == read_cloud_truth(folder).keys()


@pytest.mark.parametrize("text", ["", "{", '{"id": 1}', "[" * 100_000])
def test_files_that_are_no_list_of_cases(tmp_path: Path, text: str) -> None:
    with pytest.raises(CasesError, match=r"cases\.json.*remedy"):
        read_cloud_cases(tmp_path)
    (tmp_path / "cases.json").write_text(text)
    with pytest.raises(CasesError, match=r"cases\.json.*remedy"):
        read_cloud_cases(tmp_path)


@pytest.mark.parametrize(
    "entry",
    [
        5,
        {"id": "a"},
        *(
            {"id": "a", "T_reference_source": T}
            for T in ("x", [[1, 2]], np.zeros((4, 4)).tolist(), [[None] * 4] * 4, [[10**400] * 4] * 4)
        ),
        *(
            {"id": "a", "T_reference_source": np.diag([*scales, 1.0]).tolist()}
            for scales in ([1.0, 1.0, 1.1], [0.3048, 0.3048, 1.0], [1.0, -1.0, 1.0], [1e200, 1e200, 1e-300])
        ),
        {"id": "a", "T_reference_source": [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
    ],
)
def test_truth_that_is_no_similarity(tmp_path: Path, entry: object) -> None:
    assert read_cloud_truth(tmp_path) == {}
    (tmp_path / "truth.json").write_text(json.dumps([entry]))
    with pytest.raises(CasesError, match=r"truth\.json: entry 1: .*T_reference_source.*remedy"):
        read_cloud_truth(tmp_path)


def test_truth_may_be_rounded(tmp_path: Path) -> None:
    T = about(np.array([20.0, 10.0, 3.0]), np.radians(23.4), 1.013, np.array([5.0, -7.0, 1.0])).round(3)
    (tmp_path / "truth.json").write_text(json.dumps([{"id": "a", "T_reference_source": T.tolist()}]))
    np.testing.assert_array_equal(read_cloud_truth(tmp_path)["a"], T)


def test_priors_come_in_radians(folder: Path) -> None:
    case = read_cloud_cases(folder)[0]
    assert isinstance(case, CloudCase)
    assert case.prior == RegistrationPrior(10.0, 3.0, np.radians(3.0), np.radians(0.3), 0.01)
    grown = read_cloud_cases(folder)[1]
    assert isinstance(grown, CloudCase) and grown.prior.sigma_growth_m == 1.5
    bad = read_cloud_cases(folder)[6]
    assert isinstance(bad, BadCloudCase) and bad.why == "sigma_scale is not a number: 'wide'"


def test_ids_come_back_as_they_were_given(folder: Path) -> None:
    """Whoever joins the results on them finds none where 3 has become "3"; truths meet either way."""
    entry, bad = ({"source": f"{name}_source.npz", "reference": "a_reference.npz", **SIGMAS} for name in ("a", "absent"))
    ids = [0, 3, "4", 2.5, "5"]
    given = [*(entry | {"id": case_id} for case_id in ids), bad | {"id": 7}, entry, entry | {"id": [1]}]
    (folder / "cases.json").write_text(json.dumps(given))
    truth = [{"id": case_id, "T_reference_source": np.eye(4).tolist()} for case_id in (0, "3", 4, "2.5")]
    (folder / "truth.json").write_text(json.dumps(truth))
    document, results = evaluate_cloud(folder, "means")
    back = [case["id"] for case in json.loads(json.dumps(document, allow_nan=False))["cases"]]
    assert back == [*ids, 7, "entry7", "[1]"] and [type(case_id) for case_id in back[:4]] == [int, int, str, float]
    assert [r.has_truth for r in results] == [True] * 4 + [False] * 4


def test_what_is_given_as_exact_is_found_where_it_is(tmp_path: Path) -> None:
    """An answer that differs from an exact prior by a centimetre is right, and no contradiction."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-70, 70, (60_000, 2))
    crowns = np.column_stack([rng.uniform(-70, 70, (160, 2)), rng.uniform(2, 9, 160), rng.uniform(1.5, 4, 160)])
    upper = [h * np.maximum(0, 1 - ((xy - [e, n]) ** 2).sum(1) / r**2) for e, n, h, r in crowns]
    points = np.column_stack([xy, np.max(upper, 0) + 0.02 * xy[:, 0] + rng.normal(0, 0.05, len(xy))])
    inner = np.abs(points[:, :2]).max(1) < 30
    np.savez_compressed(tmp_path / "source.npz", points=points[::2][inner[::2]])
    np.savez_compressed(tmp_path / "reference.npz", points=points[1::2])
    entry = {"source": "source.npz", "reference": "reference.npz", **SIGMAS}
    exact = [entry | {"id": field, field: 0.0} for field in SIGMAS] + [entry | dict.fromkeys(SIGMAS, 0.0) | {"id": "all"}]
    (tmp_path / "cases.json").write_text(json.dumps([entry | {"id": "none"}, *exact]))
    document = evaluate_cloud(tmp_path, DEFAULT_METHOD)[0]
    assert {case["id"]: case["status"] for case in document["cases"]} == dict.fromkeys(["none", *SIGMAS, "all"], "fix")
    for case in document["cases"]:
        assert np.abs(np.array(case["T_reference_source"]) - np.eye(4)).max() < 0.2


def test_command_writes_json_and_report(folder: Path, tmp_path: Path) -> None:
    report = tmp_path / "report"
    out = report / "out.json"
    command = ["cloud", str(folder), "--method", "means", "--json", str(out), "--report", str(report)]
    result = CliRunner().invoke(evaluate_app, command)
    assert result.exit_code == 0, result.output
    written = json.loads(out.read_text())
    assert written["method"] == "means" and written["schema"] == 1 and len(written["cases"]) == 14
    for words in ("nan.npz: points: 180 values are not finite", "town                     2 of 2 accepted", "far_and_accepted"):
        assert words in result.output
    page = (report / "report.html").read_text()
    for words in ("By place", "wood_B_00", "data:image/jpeg;base64", "(refused)", "Are the claims true?"):
        assert words in page
    assert "http" not in page and ">nan" not in page
    assert page.count("<tr") == page.count("</tr>")


def test_methods_are_listed_and_unknown_ones_refused(folder: Path) -> None:
    listed = CliRunner().invoke(evaluate_app, ["cloud", "--list-methods"])
    assert listed.output.split() == list(METHODS) and "gicp" in METHODS
    assert evaluate_cloud_command.DEFAULT_METHOD == DEFAULT_METHOD
    for arguments in (["cloud", str(folder), "--method", "psychic"], ["cloud", "--method", "means"]):
        assert isinstance(CliRunner().invoke(evaluate_app, arguments).exception, ConfigError)
    with pytest.raises(ConfigError, match="psychic"):
        evaluate_cloud(folder, "psychic")


def test_values_for_no_data_are_left_out_of_a_case_and_of_its_errors_and_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    bumps, tall = rng.uniform(-60, 60, (150, 2)), rng.uniform(2, 8, 150)

    def ground(side_m: float) -> np.ndarray:
        xy = rng.uniform(-side_m / 2, side_m / 2, (int(3 * side_m**2), 2))
        away = ((xy[:, None] - bumps) ** 2).sum(2)
        return np.column_stack([xy, (tall * np.exp(-away / 8)).max(1) + rng.normal(0, 0.05, len(xy))])

    source, reference = ground(50) - SHIFT, ground(100)
    source[::200], reference[::200, 2], reference[1::200, 2] = -9999.0, 9999.0, -9999.0
    np.savez_compressed(tmp_path / "source.npz", points=source + FAR_ORIGIN * (source[:, :1] > -999))
    np.savez_compressed(tmp_path / "reference.npz", points=reference + FAR_ORIGIN)
    case = {"id": "a", "source": "source.npz", "reference": "reference.npz", **SIGMAS}
    T = np.eye(4)
    T[:3, 3] = SHIFT
    (tmp_path / "cases.json").write_text(json.dumps([case]), encoding="utf-8")
    (tmp_path / "truth.json").write_text(json.dumps([{"id": "a", "T_reference_source": T.tolist()}]), encoding="utf-8")
    _, (result,) = evaluate_cloud(tmp_path, "height-search")
    assert result.fix is not None
    assert result.error is not None
    assert result.error.mtre_m < 0.5
    assert f"{len(source[::200])} points far from all others are left out of the source" in result.detail
    assert "are left out of the reference" in result.detail


def test_a_key_that_is_there_twice_is_refused(tmp_path):
    """The last one counted, in silence."""
    (tmp_path / "cases.json").write_text('[{"id": "a", "source": "a.npz", "source": "b.npz"}]')
    with pytest.raises(CasesError, match=r"cases\.json: cannot be read: 'source' twice in one entry, .*'b\.npz'"):
        read_cloud_cases(tmp_path)


@pytest.mark.parametrize("suffix", [".laz", ".LAS"])
def test_without_what_reads_its_clouds_nothing_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    """Each case was a `no_fix`, and the exit code 0: figures that say the method found nothing."""
    entry = {"id": "a", "source": "a.npz", "reference": f"b{suffix}", **SIGMAS}
    (tmp_path / "cases.json").write_text(json.dumps([entry]))
    monkeypatch.setattr(evaluated, "find_spec", lambda name: None if name == "laspy" else find_spec(name))
    with pytest.raises(ConfigError, match=r"needs laspy.*prep"):
        evaluate_cloud(tmp_path, "height-search")
    (tmp_path / "cases.json").write_text(json.dumps([entry | {"reference": "b.npz"}]))
    assert evaluate_cloud(tmp_path, "height-search")[1][0].reason is Reason.BAD_INPUT
