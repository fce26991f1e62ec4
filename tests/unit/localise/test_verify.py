from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.verify import (
    AGAIN_WEIGHTS,
    DEEP_WEIGHTS,
    FAR_PX,
    GRADIENT_WEIGHTS,
    Evidence,
    block_z,
    fewer_places,
    probability_near,
    probability_wrong,
    refusal,
    within,
)

GOOD = Evidence(
    score=0.6,
    coarse_score=0.6,
    runner_up=0.5,
    lead=6.0,
    mode_mass=0.9,
    blocks=36.0,
    agreeing=30.0,
    footprint_px=170.0,
    scatter=0.8,
    height_sigmas=0.5,
    yaw_sigmas=0.5,
    position_sigmas=0.5,
    tilt_sigmas=0.5,
    returning=0.7,
    sigma_px=0.4,
)


def test_good_evidence_is_accepted():
    assert probability_wrong(GOOD, GRADIENT_WEIGHTS) < 0.001
    assert refusal(GOOD, 0.001, 0.01) is None


@pytest.mark.parametrize(
    ("name", "worse"),
    [
        *(("score", 0.2), ("runner_up", 1.0), ("agreeing", 4.0), ("scatter", 4.0), ("position_sigmas", 3.0), ("sigma_px", 3.0)),
        *(("lead", 1.0), ("mode_mass", 0.5), ("returning", 0.2)),
    ],
)
@pytest.mark.parametrize("weights", [GRADIENT_WEIGHTS, DEEP_WEIGHTS, AGAIN_WEIGHTS])
@pytest.mark.parametrize("footprint_px", [48.0, 96.0, 170.0, 200.0])
def test_probability_rises_with_worse_evidence(name, worse, weights, footprint_px):
    good = replace(GOOD, footprint_px=footprint_px)
    assert probability_wrong(replace(good, **{name: worse}), weights) > probability_wrong(good, weights)


@pytest.mark.parametrize("weights", [DEEP_WEIGHTS, AGAIN_WEIGHTS])
@pytest.mark.parametrize("footprint_px", [48.0, 96.0, 170.0, 200.0])
def test_probability_rises_where_the_search_saw_less_of_a_likeness(weights, footprint_px):
    good = replace(GOOD, footprint_px=footprint_px)
    assert probability_wrong(replace(good, coarse_score=0.3), weights) > probability_wrong(good, weights)


@pytest.mark.parametrize(
    ("evidence", "reason"),
    [
        (replace(GOOD, height_sigmas=5.0), Reason.INCONSISTENT_WITH_PRIOR),
        (replace(GOOD, yaw_sigmas=5.0), Reason.INCONSISTENT_WITH_PRIOR),
        (replace(GOOD, position_sigmas=5.0), Reason.INCONSISTENT_WITH_PRIOR),
        (replace(GOOD, tilt_sigmas=5.0), Reason.INCONSISTENT_WITH_PRIOR),
        (replace(GOOD, score=0.05, agreeing=3.0), Reason.NO_MATCH),
        (replace(GOOD, score=0.2, coarse_score=0.2, runner_up=0.99, lead=0.1, mode_mass=0.5, agreeing=6.0), Reason.AMBIGUOUS),
        (replace(GOOD, score=0.2, coarse_score=0.2, runner_up=0.8, agreeing=3.0), Reason.BLOCKS_DISAGREE),
    ],
)
def test_refusals_name_their_reason(evidence, reason):
    refused = refusal(evidence, probability_wrong(evidence, GRADIENT_WEIGHTS), 0.01)
    assert refused is not None
    assert refused[0] is reason


def test_agreement_by_chance_counts_nothing():
    assert abs(block_z(100, 7.44)) < 1e-9
    assert block_z(36, 30) > 10
    assert block_z(0, 0) == 0


def test_evidence_survives_being_reported():
    assert Evidence.from_numbers(GOOD.numbers() | {"p_wrong": 0.1}) == GOOD


def test_a_position_that_may_be_far_off_is_declined_though_the_place_be_right():
    vague = replace(GOOD, sigma_px=3.0)
    p = probability_wrong(vague, GRADIENT_WEIGHTS)
    assert p == pytest.approx(1 - probability_near(3.0), abs=0.001)
    assert refusal(vague, p, 0.05) is not None


def test_share_of_positions_that_are_near_is_what_repetition_shows():
    errors = np.random.default_rng(1).normal(0, 2.5, (20000, 2))
    assert probability_near(2.5) == pytest.approx(float(np.mean(np.hypot(*errors.T) <= FAR_PX)), abs=0.01)
    assert probability_near(0.5) == pytest.approx(1.0)
    assert probability_near(0.0) == 1.0


def test_the_fewer_places_there_are_the_fewer_times_chance_is_another_one():
    weak = replace(GOOD, score=0.2, coarse_score=0.3, runner_up=0.9, agreeing=6.0, lead=1.0)

    def odds(prior_px: float) -> float:
        p = probability_wrong(replace(weak, prior_px=prior_px), GRADIENT_WEIGHTS)
        return p / (1 - p)

    assert odds(2.0) == pytest.approx(4 * odds(1.0))
    assert odds(30.0) == pytest.approx(odds(np.inf))
    assert odds(30.0) > 10 * odds(1.0)
    assert fewer_places(0.0) < 30


def test_what_is_near_by_fix_and_prior_is_what_repetition_shows():
    rng = np.random.default_rng(2)
    for sigma, prior in ((3.0, 1.5), (3.5, 3.0), (3.0, 12.0)):
        truth, noise = rng.normal(0, prior, (4000, 2)), rng.normal(0, sigma, (4000, 2))
        claims = [probability_near(sigma, prior, float(z)) for z in np.hypot(*(truth + noise).T) / prior]
        assert np.mean(claims) == pytest.approx(float(np.mean(np.hypot(*noise.T) <= FAR_PX)), abs=0.01)
    assert probability_near(3.0, 1.0, 1.0) > 0.99 > 0.94 > probability_near(3.0, 100.0, 1.0)
    assert probability_near(3.0, 1e6, 1.0) == pytest.approx(probability_near(3.0))


@pytest.mark.parametrize(("radius", "off"), [(2.0, 0.0), (2.0, 1.5), (0.5, 3.0), (6.0, 5.0)])
def test_a_point_lies_within_a_circle_as_often_as_repetition_shows(radius, off):
    at = np.random.default_rng(3).normal((off, 0.0), 1.0, (40000, 2))
    assert within(radius, off) == pytest.approx(float(np.mean(np.hypot(*at.T) <= radius)), abs=0.01)


def test_evidence_of_before_has_no_prior():
    told = {name: value for name, value in GOOD.numbers().items() if name != "prior_px"}
    assert Evidence.from_numbers(told) == GOOD
