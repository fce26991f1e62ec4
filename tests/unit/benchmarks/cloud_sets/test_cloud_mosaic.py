"""References made larger than the clouds, and priors moved away from the truth."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("laspy")

from benchmarks.cloud_reach import rows
from benchmarks.cloud_sets.cloud_cases import CloudCase
from benchmarks.cloud_sets.cloud_mosaic import MOST_PER_M2, displaced, mosaic
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.similarity import about, moved

PRIOR = RegistrationPrior(10.0, 3.0, 0.05, 0.01, 0.01)


def case(height_m: float, T: np.ndarray) -> CloudCase:
    rng = np.random.default_rng(2)
    square = np.column_stack([rng.uniform(-50, 50, (40_000, 2)), np.full(40_000, height_m)])
    return CloudCase("a_A_00", "a", "A", "normal", square[:500] * 0.3, square, PRIOR, T)


def test_a_mosaic_has_the_own_reference_in_its_place_and_others_around_it_at_one_density():
    made = mosaic(case(1.0, np.eye(4)), [case(2.0, np.eye(4))], np.array([120.0, 0.0]), 200.0, np.random.default_rng(1))
    points = made.reference_m
    own = (np.abs(points[:, :2]) < 49.9).all(1)
    assert set(points[own, 2]) == {1.0}
    assert set(points[(np.abs(points[:, :2]) > 50.1).any(1), 2]) == {2.0}
    assert points[:, 0].min() < -80
    assert points[:, 0].max() > 320
    assert own.sum() / 99.8**2 == pytest.approx(MOST_PER_M2, rel=0.02)


def test_a_displaced_prior_is_off_by_what_was_asked_and_the_truth_stays():
    true = about(np.zeros(3), 0.05, 1.01, np.array([20.0, -30.0, 2.0]))
    before = case(1.0, true)
    after = displaced(before, np.array([300.0, 100.0]), 288.0)
    np.testing.assert_allclose(moved(after.T_true, after.source_m), moved(true, before.source_m))
    middle = after.source_m.mean(0)
    np.testing.assert_allclose((moved(after.T_true, middle) - middle)[:2], [300.0, 100.0])
    assert after.prior.sigma_horizontal_m == 288.0


def test_rows_count_what_distance_alone_loses():
    flat = case(1.0, np.eye(4))
    lines = list(rows("flat", [lambda error_m: displaced(flat, np.array([error_m, 0.0]), error_m)], [5.0, 10.0]))
    assert [line.split(" | ")[1] for line in lines] == ["5", "10"]
    assert "| 0.0 | 0.0 |" in lines[1], "nothing is found on a plane, so nothing of it can be kept"
