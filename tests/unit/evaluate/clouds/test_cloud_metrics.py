from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.evaluate.clouds.cloud_metrics import CloudResult, by_place, cloud_error, place_of, summarise
from visloc_companion.evaluate.clouds.cloud_pictures import SIDE_PX, UNKNOWN, coloured, coloured_difference, height_map
from visloc_companion.evaluate.clouds.cloud_report import worst_cases
from visloc_companion.localise.registration.base import Registered

SOURCE = np.random.default_rng(5).uniform(-30, 30, (500, 3)) * [1, 1, 0.2] + [200.0, -100.0, 5.0]


def placed(off: tuple[float, float, float], p: float = 0.01, covariance: np.ndarray | None = None) -> Registered:
    T = np.eye(4)
    T[:3, 3] = off
    return Registered(T, np.eye(3) if covariance is None else covariance, 0.01, 0.001, p, ())


def result(name: str, off: tuple[float, float, float], p: float = 0.01) -> CloudResult:
    answer, reason = placed(off, p), Reason.AMBIGUOUS if p > 0.05 else None
    return CloudResult(name, answer, reason, elapsed_ms=5.0, error=cloud_error(answer, np.eye(4), SOURCE), has_truth=True)


def test_a_shift_is_its_own_error() -> None:
    error = cloud_error(placed((3.0, 4.0, 12.0), covariance=np.diag([9.0, 4.0, 16.0])), np.eye(4), SOURCE)
    assert error.mtre_m == pytest.approx(13.0) and error.horizontal_m == pytest.approx(5.0)
    np.testing.assert_allclose(error.sigmas, [1.0, 2.0, 3.0], rtol=1e-6)
    assert error.chi2 == pytest.approx(5.0, rel=1e-6)
    assert error.far and not error.wrong


def test_a_turn_about_the_middle_moves_points_but_not_the_middle() -> None:
    angle, scale = math.radians(10.0), 1.01
    c, s = math.cos(angle), math.sin(angle)
    low, high = SOURCE[:, :2].min(0), SOURCE[:, :2].max(0)
    middle = np.array([*(low + high) / 2, SOURCE[:, 2].mean()])
    T = np.eye(4)
    T[:3, :3] = scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    T[:3, 3] = middle - T[:3, :3] @ middle
    error = cloud_error(Registered(T, np.eye(3), 0.1, 0.1, 0.0, ()), np.eye(4), SOURCE)
    assert error.horizontal_m < 1e-9 and 2 < error.mtre_m < 6
    assert error.yaw_deg == pytest.approx(10.0) and error.scale == pytest.approx(0.01)


def test_places_are_ids_without_scenario_and_number() -> None:
    names = {"delft_ahn3_A_04": "delft_ahn3", "bragg_west_B_11": "bragg_west", "case7": "case", "7": "7", "wood": "wood"}
    assert {name: place_of(name) for name in names} == names
    groups = by_place([result(name, (0, 0, 0)) for name in ("a_A_00", "b_A_00", "a_B_01")])
    assert {name: [r.case_id for r in group] for name, group in groups.items()} == {"a": ["a_A_00", "a_B_01"], "b": ["b_A_00"]}


def test_true_claims_are_called_true_and_small_ones_are_seen() -> None:
    rng = np.random.default_rng(3)
    honest = summarise([result(f"a_A_{k}", tuple(rng.normal(size=3))) for k in range(400)])
    assert all(0.9 < value < 1.1 for value in honest["rms_error_over_sigma"].values())
    assert 0.92 < honest["inside_95_ellipse_share"] < 0.98
    bold = summarise([result(f"a_A_{k}", tuple(2 * rng.normal(size=3))) for k in range(400)])
    assert bold["rms_error_over_sigma"]["east"] > 1.8 and bold["inside_95_ellipse_share"] < 0.7


def test_far_answers_count_where_they_are_accepted() -> None:
    results = [result("a", (0.5, 0, 0)), result("b", (20.0, 0, 0), p=0.3), result("c", (6.0, 0, 0)), result("d", (0, 0, 11.0))]
    summary = summarise(results)
    assert (summary["n_fix"], summary["wrong_and_accepted"], summary["far_and_accepted"]) == (3, 1, 1)
    assert summary["within_1m_share"] == 0.25 and summary["within_5m_horizontal_share"] == 0.5
    assert summary["separation_of_far"] == pytest.approx(0.75) and summary["reliability"]["n_wrong"] == 2
    assert summary["heading_error_deg"]["max"] == 0.0
    assert summarise([CloudResult("x", None, Reason.BAD_INPUT)])["elapsed_ms"] is None


def test_worst_are_the_accepted_far_ones_then_the_largest_errors() -> None:
    results = [result("small", (1, 0, 0)), result("doubted", (50, 0, 0), p=0.5), result("far", (11, 0, 0))]
    assert [r.case_id for r in worst_cases(results, 3)] == ["far", "doubted", "small"]


def test_height_maps_lie_north_up() -> None:
    points = np.array([[0.5, 9.5, 1.0], [0.5, 9.5, 3.0], [9.5, 0.5, 2.0], [50.0, 0.0, 9.0]])
    grid = height_map(points, np.array([5.0, 5.0]), 10.0, 10)
    assert grid[0, 0] == 3.0 and grid[9, 9] == 2.0 and np.isfinite(grid).sum() == 2
    picture = coloured(grid, 0.0, 3.0)
    assert picture.shape == (SIDE_PX, SIDE_PX, 3) and tuple(picture[SIDE_PX // 2, SIDE_PX // 2]) == UNKNOWN
    assert picture[5, 5, 0] > 200 and picture[5, 5, 2] < 80, "the highest is yellow"
    above, below = coloured_difference(np.array([[9.0, -9.0], [0.0, np.nan]]))[:: SIDE_PX - 1][0][[0, -1]]
    assert above[0] > 150 > above[2] and below[2] > 150 > below[0]
