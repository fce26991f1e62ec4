from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.claims import WEIGHTS, answer, doubted, probability_wrong, regressors
from visloc_companion.localise.registration.evidence import Evidence
from visloc_companion.localise.registration.refine import Refined

GOOD = Evidence(
    correlation=0.9,
    overlap=0.95,
    rival=0.3,
    blocks=0.95,
    formal_sigma_m=0.03,
    deviation_m=0.4,
    relief_m=3.0,
    bowl_m=0.1,
    prior_chi2=4.0,
)
PRIOR = RegistrationPrior(20.0, 3.0, 0.05, 0.01, 0.012)
REFINED = Refined(np.eye(4), 0.1, np.diag([1e-3, 2e-3, 1e-6, 1e-6]), np.diag([1e-4, 1e-6, 1e-6, 1e-3]), 0.3, 0.4)


def test_a_weight_for_every_regressor():
    assert len(WEIGHTS) == len(regressors(GOOD))


def test_the_distance_from_the_prior_is_doubt_up_to_a_limit():
    near, far, farther = (probability_wrong(replace(GOOD, rival=0.8, prior_chi2=c)) for c in (2.0, 30.0, 300.0))
    assert near < far == farther


def test_a_rival_nearly_as_good_is_doubt():
    claims = [probability_wrong(replace(GOOD, rival=rival)) for rival in (0.2, 0.5, 0.8, 0.86)]
    assert claims == sorted(claims)
    assert claims[0] < 0.02
    assert claims[-1] > 0.3


def test_what_is_the_opposite_of_the_map_is_no_evidence():
    assert probability_wrong(replace(GOOD, correlation=-0.9, rival=0.0)) == probability_wrong(
        replace(GOOD, correlation=0.0, rival=0.0)
    )


def test_declines_with_the_reason_that_is_worst():
    alike = answer(REFINED, replace(GOOD, rival=0.87), PRIOR, 0.05)
    flat = answer(REFINED, replace(GOOD, correlation=0.1, rival=0.1, relief_m=0.02), PRIOR, 0.05)
    assert isinstance(alike, NotRegistered)
    assert isinstance(flat, NotRegistered)
    assert (alike.reason, flat.reason) == (Reason.AMBIGUOUS, Reason.LOW_TEXTURE)
    assert dict(alike.evidence)["probability_wrong"] > 0.05


@pytest.mark.parametrize("other", [{"rival": 0.87}, {"correlation": 0.1, "rival": 0.1, "relief_m": 0.02}])
def test_what_was_answered_in_spite_of_doubt_has_the_refusal_that_it_would_have_been(other):
    evidence = replace(GOOD, **other)
    asked = answer(REFINED, evidence, PRIOR, 1.0)
    assert isinstance(asked, Registered)
    assert doubted(asked) == answer(REFINED, evidence, PRIOR, 0.05)


def test_growth_widens_the_height_alone():
    before = answer(REFINED, GOOD, PRIOR, 1.0)
    after = answer(REFINED, GOOD, replace(PRIOR, sigma_growth_m=2.0), 1.0)
    assert isinstance(before, Registered)
    assert isinstance(after, Registered)
    np.testing.assert_array_equal(after.covariance_m2[:2, :2], before.covariance_m2[:2, :2])
    assert after.covariance_m2[2, 2] - before.covariance_m2[2, 2] == pytest.approx(4.0)
