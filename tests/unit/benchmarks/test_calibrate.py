"""What claims are fitted on, and that they are fitted as they are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.evaluate.cases import Truth
from visloc_companion.evaluate.images.image_metrics import CaseResult
from visloc_companion.localise.verify import AGAIN_WEIGHTS, DEEP_WEIGHTS, QUARTER_WEIGHTS, Evidence
from visloc_companion.types import Fix, GeoPoint

PLACE = GeoPoint(48.0, 11.0, 100.0)
TRUTH = Truth(48.0, 11.0, 100.0, 0.0, 5.0, True)


def answer(share: float, votes: float) -> CaseResult:
    """A right answer, the place of which others, and the blocks on their own, leave so much."""
    evidence = Evidence(0.8, 0.7, 0.5, 4.0, 0.9, 36, 30, 96, 0.5, 0.2, 0.3, 0.4, 0.1, 0.9, 1.5, prior_px=12.0)
    numbers = evidence.numbers() | {"share": share, "votes": votes, "looks": 1.0}
    fix = Fix(0, 0, 1, 1, "deep", PLACE, (1.0, 0.0, 0.0, 0.0), ((4.0, 0.0), (0.0, 4.0)), 1.0, 0.01, 0.5, 1.0)
    return CaseResult("t2/c0", fix, None, evidence=numbers, map_gsd_m=5.0)


@pytest.mark.parametrize(("share", "votes"), [(1.0, 1.0), (0.6, 1.0), (1.0, 0.7), (0.5, 0.4)])
def test_what_is_fitted_is_what_is_claimed_in_flight(load, share, votes):
    result = answer(share, votes)
    samples = load("calibrate").collect("deep", {"t2": [(result, TRUTH)]})
    (fitted,) = load("calibrate").probability_wrong(samples.x, np.array(DEEP_WEIGHTS), samples.sure, samples.fewer)
    flown = load("image_cases.answers").judged_anew(result, "deep").fix
    assert flown is not None
    assert fitted == pytest.approx(flown.probability_wrong, abs=1e-9)


def test_quarters_are_fitted_as_they_are_claimed_in_flight(load):
    without = answer(0.6, 0.7)
    asked = replace(without, case_id="t2/c1", evidence=without.evidence | {"quarters": 3.0})
    samples = load("calibrate").collect_asked({"t2": [(without, TRUTH), (asked, TRUTH)]})
    assert samples.x.shape == (1, len(QUARTER_WEIGHTS))
    (fitted,) = load("calibrate").probability_wrong(samples.x, np.array(QUARTER_WEIGHTS), samples.sure, samples.fewer)
    flown = load("image_cases.answers").judged_anew(asked, "deep").fix
    assert flown is not None
    assert fitted == pytest.approx(flown.probability_wrong, abs=1e-9)
    unasked = load("image_cases.answers").judged_anew(without, "deep").fix
    assert unasked is not None
    assert unasked.probability_wrong != flown.probability_wrong


def test_quarters_are_no_part_of_what_the_looks_are_fitted_on(load):
    """They are asked of some alone, by what the looks claim."""
    without = answer(0.2, 0.7)
    asked = replace(without, evidence=without.evidence | {"quarters": 9.0})
    collect = load("calibrate").collect
    (of_without,), (of_asked,) = (collect("deep", {"t2": [(each, TRUTH)]}).sure for each in (without, asked))
    assert of_asked == of_without


def test_nothing_is_fitted_to_families_that_are_judged_only(load, capsys):
    module, rng = load("calibrate"), np.random.default_rng(5)
    x = np.column_stack([np.ones(200), rng.normal(size=200)])
    right = (rng.uniform(size=200) < 1 / (1 + np.exp(-x[:, 1]))).astype(float)
    family = np.repeat(["naip", "woods", "alike", "moved"], 50)
    right[100:] = x[100:, 1] < 0  # there the regressor says the contrary

    def printed(which: np.ndarray) -> list[str]:
        n = int(which.sum())
        samples = module.Samples(x[which], right[which], np.ones(n), np.zeros(n), family[which], None, {})
        module._fitted(samples, samples)
        return capsys.readouterr().out.strip().split("\n")

    every, fitted = printed(np.full(200, True)), printed(np.isin(family, ["naip", "woods"]))
    assert every[:2] == fitted[:2]  # the weights, and how honest they are on what they are fitted to
    judged = [line for line in every if line.startswith("fitted without")]
    assert [line.split(",")[0] for line in judged] == [f"fitted without {f}" for f in ("alike", "moved", "naip", "woods")]
    assert [line for line in judged if "naip" in line or "woods" in line] == [
        line for line in fitted if line.startswith("fitted without")
    ]


def test_every_training_set_is_of_a_family(load):
    sets = load("image_cases.training_sets")
    assert sorted(name for names in sets.FAMILIES.values() for name in names) == sorted(sets.SETS)


def test_nothing_counts_against_a_match_that_speaks_for_one(load):
    """Of two regressors that say nearly the same the fit without signs takes one against the other."""
    rng = np.random.default_rng(7)
    score = rng.normal(size=600)
    x = np.column_stack([np.ones(600), score, score + 0.1 * rng.normal(size=600)])
    y = (rng.uniform(size=600) < 1 / (1 + np.exp(-2 * x[:, 1] + 0.8 * (x[:, 2] - x[:, 1]) / 0.1))).astype(float)
    module = load("calibrate")
    assert module.fit_logistic(x, y, ridge=1.0)[2] < -0.5
    fitted = module.fit_logistic(x, y, ridge=1.0, signs=(0, 1, 1))
    assert fitted[1] > 0
    assert fitted[2] == pytest.approx(module.LEAST / x[:, 2].std(), rel=1e-6)
    p = module.probability_wrong(x, fitted)
    assert p.sum() == pytest.approx((1 - y).sum(), rel=0.02)


@pytest.mark.parametrize("weights", [DEEP_WEIGHTS, AGAIN_WEIGHTS])
def test_every_witness_counts_as_it_should(load, weights):
    signs = load("calibrate").SIGNS
    regressors = Evidence.from_numbers(answer(1.0, 1.0).evidence).regressors()
    assert len(signs) == len(regressors) == len(weights)
    assert all(weight * sign > 0 for weight, sign in zip(weights, signs, strict=True) if sign)
