from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.evaluate.reliability import (
    MAX_CALIBRATION_ERROR,
    bins_of,
    excess_sigmas,
    expected_calibration_error,
    reliability,
    reliability_diagram,
    separation,
)


@pytest.fixture
def truth():
    """True probabilities of being wrong, as a localiser's are: most answers nearly sure, some doubtful; and what came of them."""
    rng = np.random.default_rng(7)
    p = np.concatenate([rng.beta(0.2, 12, 3000), rng.uniform(0, 1, 600)])
    return p, rng.uniform(size=p.size) < p


def test_true_claims_are_honest(truth):
    figures = reliability(*truth)
    assert figures["honest"]
    assert figures["expected_calibration_error"] < 0.02
    assert abs(figures["excess_sigmas"]) < 3
    assert figures["claimed_wrong"] == pytest.approx(figures["n_wrong"], rel=0.15)


@pytest.mark.parametrize("factor", [0.1, 0.3, 0.6])
def test_overconfident_claims_fail(truth, factor):
    p, wrong = truth
    figures = reliability(p * factor, wrong)
    assert not figures["honest"]
    assert figures["excess_sigmas"] > 3


def test_overconfidence_shows_even_where_hardly_anything_is_wrong():
    """5 of 1,000 wrong at a claim of 0.0005: within every bin's calibration error, but no accident."""
    p, wrong = np.full(1000, 0.0005), np.arange(1000) < 5
    figures = reliability(p, wrong)
    assert figures["expected_calibration_error"] < MAX_CALIBRATION_ERROR
    assert not figures["honest"]


def test_timid_claims_fail_by_their_calibration_error(truth):
    p, wrong = truth
    figures = reliability(0.3 + 0.7 * p, wrong)
    assert not figures["honest"]
    assert figures["excess_sigmas"] < -3


def test_calibration_error_by_hand():
    p, wrong = np.array([0.05, 0.05, 0.95, 0.95]), np.array([False, True, True, True])
    assert expected_calibration_error(p, wrong) == pytest.approx(0.5 * 0.45 + 0.5 * 0.05)
    assert [(b.n, b.claimed, b.wrong) for b in bins_of(p, wrong)] == [(2, 0.05, 0.5), (2, 0.95, 1.0)]
    assert expected_calibration_error(np.zeros(0), np.zeros(0, bool)) is None


def test_a_certain_claim_falls_into_the_last_bin():
    assert bins_of(np.array([1.0]), np.array([True]))[0].low == pytest.approx(0.9)


def test_separation_is_the_chance_of_the_right_order():
    wrong = np.array([True, True, False, False])
    assert separation(np.array([0.9, 0.8, 0.1, 0.2]), wrong) == 1.0
    assert separation(np.array([0.1, 0.2, 0.9, 0.8]), wrong) == 0.0
    assert separation(np.full(4, 0.3), wrong) == 0.5
    assert separation(np.array([0.3]), np.array([True])) is None


def test_no_claims_are_no_excess():
    assert excess_sigmas(np.zeros(0), np.zeros(0, bool)) == 0.0
    assert reliability(np.zeros(0), np.zeros(0, bool))["honest"] is False


def test_the_diagram_draws_one_mark_for_each_occupied_bin(truth):
    p, wrong = truth
    drawing = reliability_diagram(p, wrong)
    assert drawing.count('class="mark"') == len(bins_of(p, wrong))
    assert "nan" not in drawing
