from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.claims import (
    LEAST_JOINT_LEAD,
    LEAST_LEAD,
    LEAST_PARTS_LEAD,
    LOOSE_M,
    MOST_CHI2,
    SURE_GROUND,
    SURE_RARE,
    USUAL_RELIEF,
    WEIGHTS,
    WRONG_SHARE,
    answer,
    doubted,
    in_view_of_unseen,
    lead,
    probability_wrong,
    regressors,
)
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
    refined_rival=0.3,
    source_relief_m=2.5,
    parts_lead=0.3,
    joint_lead=0.45,
)
PRIOR = RegistrationPrior(20.0, 3.0, 0.05, 0.01, 0.012)
REFINED = Refined(np.eye(4), 0.1, np.diag([1e-3, 2e-3, 1e-6, 1e-6]), np.diag([1e-4, 1e-6, 1e-6, 1e-3]), 0.4)


def test_a_weight_for_every_regressor():
    assert len(WEIGHTS) == len(regressors(GOOD))


def test_the_distance_from_the_prior_is_doubt_and_beyond_a_limit_disbelief():
    doubtful = replace(GOOD, rival=0.8, refined_rival=0.75)
    near, far = (probability_wrong(replace(doubtful, prior_chi2=c)) for c in (2.0, MOST_CHI2))
    assert near < far
    leads = replace(GOOD, correlation=1.0, overlap=1.0, rival=0.0, refined_rival=0.0, parts_lead=1.0, joint_lead=3.0)
    assert probability_wrong(replace(leads, prior_chi2=MOST_CHI2)) < 0.01
    assert probability_wrong(replace(leads, prior_chi2=MOST_CHI2 + 1)) >= 0.5


def test_a_rival_nearly_as_good_is_doubt():
    claims = [probability_wrong(replace(GOOD, rival=rival, refined_rival=rival)) for rival in (0.2, 0.5, 0.8, 0.86)]
    assert claims == sorted(claims)
    assert claims[0] < 0.02
    assert claims[-1] > 0.3


def test_what_is_the_opposite_of_the_map_is_no_evidence():
    assert probability_wrong(replace(GOOD, correlation=-0.9, rival=0.0)) == probability_wrong(
        replace(GOOD, correlation=0.0, rival=0.0)
    )


def test_a_rival_that_was_refined_is_more_doubt_than_one_that_was_not():
    one, other = (replace(GOOD, rival=0.8, refined_rival=refined) for refined in (0.4, 0.8))
    assert probability_wrong(one) < probability_wrong(other)


@pytest.mark.parametrize("ratio", [0.0, 0.15, 2.8])
def test_reliefs_of_much_unlike_size_are_not_believed_however_far_the_place_leads(ratio):
    leads = replace(GOOD, correlation=1.0, overlap=1.0, rival=0.0, refined_rival=0.0)
    assert probability_wrong(replace(leads, source_relief_m=3.0 * ratio)) >= 0.5
    usual = [probability_wrong(replace(leads, source_relief_m=3.0 * inside)) for inside in USUAL_RELIEF]
    assert usual[0] == usual[1] == probability_wrong(leads) < 0.05


def test_gullies_that_two_surveys_see_unlike_are_believed_where_they_lead():
    """Two epochs of bragg, half a metre off: the source's relief is 1.7 times the reference's. All looks lead by the least of 36
    others whose parts lead so."""
    seen = replace(GOOD, correlation=0.70, overlap=0.87, rival=0.40, refined_rival=0.36, prior_chi2=1.9)
    seen = replace(seen, relief_m=0.17, source_relief_m=0.28, parts_lead=0.38, joint_lead=0.72, formal_sigma_m=0.58)
    assert probability_wrong(seen) < 0.01


def test_parts_that_would_lie_elsewhere_are_doubt():
    doubtful = replace(GOOD, correlation=0.45, rival=0.35, refined_rival=0.3)
    claims = [probability_wrong(replace(doubtful, parts_lead=lead, joint_lead=0.3 + lead)) for lead in (0.3, 0.1, 0.0)]
    assert claims[0] < claims[1] < claims[2] < 0.5
    assert probability_wrong(replace(GOOD, parts_lead=LEAST_PARTS_LEAD - 0.01)) >= 0.5


def test_a_crown_that_carries_the_correlation_alone_is_refused():
    """A suburb in the reference of another: as many sixteenths of it agree elsewhere. All looks lead by the median of 30 others
    whose parts lead so little."""
    seen = replace(GOOD, correlation=0.43, overlap=0.75, rival=0.32, refined_rival=0.29, blocks=0.48, prior_chi2=0.2)
    seen = replace(seen, relief_m=2.03, source_relief_m=1.46, formal_sigma_m=0.92, parts_lead=0.022, joint_lead=0.08)
    assert probability_wrong(seen) > 0.05
    assert probability_wrong(replace(seen, parts_lead=0.3, joint_lead=0.7)) < 0.01


def test_a_place_that_leads_by_all_looks_at_once_is_believed_though_it_leads_by_little_as_a_whole():
    """A plantation, grown and felled in part, and trees on a lawn: 0.08 before the next place each, and both right."""
    plantation = replace(GOOD, correlation=0.252, overlap=1.0, rival=0.17, refined_rival=0.17, blocks=0.444, formal_sigma_m=0.238)
    plantation = replace(plantation, relief_m=4.95, source_relief_m=2.81, bowl_m=0.167, prior_chi2=2.67, parts_lead=0.126)
    lawn = replace(GOOD, correlation=0.697, overlap=0.966, rival=0.611, refined_rival=0.605, blocks=0.69, formal_sigma_m=0.598)
    lawn = replace(lawn, relief_m=1.63, source_relief_m=1.64, bowl_m=-0.431, prior_chi2=4.88, parts_lead=0.176)
    for seen, joint in ((plantation, 0.410), (lawn, 0.749)):
        assert probability_wrong(replace(seen, joint_lead=joint)) < 0.05
        assert probability_wrong(replace(seen, joint_lead=0.1)) > 0.2


def test_a_relief_no_larger_than_the_steps_of_rounded_heights_is_not_believed():
    """Gullies of 0.27 m in whole metres, of both clouds: 4.7 m off, claimed 0.0000, level 1.6 m."""
    terraced = replace(GOOD, relief_m=0.35, source_relief_m=0.4, rounding_m=0.29)
    assert probability_wrong(terraced) >= 0.5
    found = answer(REFINED, terraced, PRIOR, 0.05)
    assert isinstance(found, NotRegistered)
    assert found.reason == Reason.LOW_TEXTURE
    assert probability_wrong(replace(terraced, rounding_m=0.14)) == probability_wrong(replace(terraced, rounding_m=0.0)) < 0.05


def test_a_cloud_bent_to_fit_is_doubt_up_to_a_limit():
    claims = [probability_wrong(replace(GOOD, bowl_m=bowl)) for bowl in (0.0, -0.5, 1.5, 9.0)]
    assert claims[0] < claims[1] < claims[2] == claims[3]


def test_a_place_held_loosely_is_doubt_up_to_a_limit():
    claims = [probability_wrong(replace(GOOD, formal_sigma_m=sigma)) for sigma in (0.1, 1.0, 3.0, 30.0)]
    assert claims[0] < claims[1] < claims[2] == claims[3]


def test_a_place_at_which_little_of_the_source_agrees_is_doubt():
    some, little = (probability_wrong(replace(GOOD, blocks=share)) for share in (0.9, 0.2))
    assert some < little


def test_a_place_without_a_lead_is_not_believed_whatever_else_speaks_for_it():
    alike = replace(GOOD, correlation=0.95, overlap=1.0, rival=0.93, refined_rival=0.93, prior_chi2=0.0)
    assert lead(alike) < LEAST_LEAD
    assert probability_wrong(alike) >= 0.5


def test_a_place_that_leads_by_all_looks_at_once_needs_no_lead_as_a_whole():
    """Gullies of two epochs, 1.3 m off: another place scores more, and nowhere do all looks agree as here."""
    seen = replace(GOOD, correlation=0.63, overlap=0.87, rival=0.62, refined_rival=0.60, blocks=0.91, formal_sigma_m=2.19)
    seen = replace(seen, relief_m=0.11, source_relief_m=0.14, bowl_m=0.01, prior_chi2=6.08, parts_lead=0.34, joint_lead=1.11)
    assert lead(seen) < LEAST_LEAD
    assert probability_wrong(seen) < 0.01
    assert probability_wrong(replace(seen, joint_lead=LEAST_JOINT_LEAD - 0.01)) >= 0.5


def test_what_agrees_rarely_by_chance_is_believed_though_it_leads_by_little():
    """Plantations, grown and felled in part, 0.2 and 0.9 m off: the second scores as much elsewhere, but its parts do not."""
    seen = replace(GOOD, correlation=0.218, overlap=1.0, rival=0.152, refined_rival=0.132, blocks=0.341, formal_sigma_m=0.176)
    seen = replace(
        seen, relief_m=4.975, source_relief_m=2.594, bowl_m=-0.036, prior_chi2=3.216, parts_lead=0.051, joint_lead=0.259
    )
    assert probability_wrong(seen) > 0.1
    assert probability_wrong(replace(seen, rare_lead=1.86)) < 0.05
    alike = replace(GOOD, correlation=0.209, overlap=1.0, rival=0.207, refined_rival=0.187, blocks=0.297, formal_sigma_m=1.848)
    alike = replace(alike, relief_m=4.813, source_relief_m=3.68, bowl_m=-0.129, prior_chi2=1.307, parts_lead=0.083)
    alike = replace(alike, joint_lead=0.362, rare_lead=2.193)
    assert probability_wrong(alike) < 0.05
    assert probability_wrong(replace(alike, rare_lead=SURE_RARE - 0.01)) >= 0.5
    assert probability_wrong(replace(alike, overlap=0.6)) >= 0.5


def test_ground_that_lies_so_nowhere_else_is_believed_though_nothing_stands_on_it():
    bare = replace(GOOD, correlation=0.2, rival=0.25, refined_rival=0.25, joint_lead=-0.1, parts_lead=-0.05, formal_sigma_m=0.5)
    assert probability_wrong(replace(bare, ground_lead=16.0)) < 0.05
    assert probability_wrong(replace(bare, ground_lead=SURE_GROUND - 0.1)) >= 0.5
    for beside in (replace(bare, prior_chi2=MOST_CHI2 + 1), replace(bare, formal_sigma_m=LOOSE_M + 0.1)):
        assert probability_wrong(replace(beside, ground_lead=16.0)) >= 0.5


def test_ground_that_has_not_changed_is_believed_the_more_it_leads_and_not_where_the_looks_lead_nowhere():
    """Fields and a wood five years later, 0.2 and 0.3 m off: little leads by the looks, and the unchanged ground does."""
    fields = replace(GOOD, correlation=0.6, rival=0.48, refined_rival=0.47, blocks=0.6, prior_chi2=10.2, parts_lead=0.02)
    fields = replace(fields, joint_lead=0.32)
    wood = replace(GOOD, correlation=0.35, rival=0.3, refined_rival=0.22, bowl_m=-0.85, parts_lead=0.07, joint_lead=0.38)
    for seen in (fields, wood):
        claims = [probability_wrong(replace(seen, lasting_lead=nats)) for nats in (0.0, 5.0, 12.0, 30.0, 90.0)]
        assert claims == sorted(claims, reverse=True)
        assert claims[0] > 0.05 > claims[2] > claims[3] == claims[4]
        for beside in (replace(seen, prior_chi2=MOST_CHI2 + 1), replace(seen, parts_lead=LEAST_PARTS_LEAD - 0.01)):
            assert probability_wrong(replace(beside, lasting_lead=30.0)) >= 0.5


def test_a_wrong_place_is_not_believed_for_the_lead_of_its_ground():
    """Another world's ground, with a lead of 13 nats, of the wrong ones that were seen the most."""
    seen = replace(GOOD, correlation=0.337, overlap=0.855, rival=0.535, refined_rival=0.445, blocks=0.332, formal_sigma_m=5.429)
    seen = replace(seen, relief_m=0.088, source_relief_m=0.131, prior_chi2=24.345, parts_lead=-0.069, joint_lead=-0.253)
    assert probability_wrong(replace(seen, lasting_lead=13.3)) > 0.99
    assert probability_wrong(replace(seen, lasting_lead=90.0)) > 0.5


def test_what_could_not_be_compared_is_doubt_by_bayes_rule():
    claims = [probability_wrong(replace(GOOD, unseen=share)) for share in (0.0, 0.2, 0.9, 1.0)]
    assert claims == sorted(claims)
    assert claims[0] == probability_wrong(GOOD)
    assert claims[3] == 1.0
    # of 1000 sources 600 belong where nothing was compared; of the others the fit's share is wrong, and looks alike
    right, wrong = 400 * (1 - WRONG_SHARE), 600 + 400 * WRONG_SHARE
    neither_way = 1 - WRONG_SHARE  # the fit's probability of a right answer whose evidence says nothing
    assert in_view_of_unseen(1 - neither_way, 0.6) == pytest.approx(wrong / (right + wrong))
    assert in_view_of_unseen(0.02, 0.0) == pytest.approx(0.02)


def test_declines_with_the_reason_that_is_worst():
    alike = answer(REFINED, replace(GOOD, rival=0.87, refined_rival=0.87), PRIOR, 0.05)
    flat = answer(REFINED, replace(GOOD, correlation=0.1, rival=0.1, refined_rival=0.1, relief_m=0.02), PRIOR, 0.05)
    assert isinstance(alike, NotRegistered)
    assert isinstance(flat, NotRegistered)
    assert (alike.reason, flat.reason) == (Reason.AMBIGUOUS, Reason.LOW_TEXTURE)
    assert dict(alike.evidence)["probability_wrong"] > 0.05


def test_a_place_that_leads_and_lies_too_far_from_the_prior_says_so():
    """Heights 30 m off, of a datum that nobody stated."""
    found = answer(REFINED, replace(GOOD, prior_chi2=108.0), PRIOR, 0.05)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.INCONSISTENT_WITH_PRIOR
    assert "10 sigma from the prior: heights of another datum" in found.detail


@pytest.mark.parametrize(
    "other", [{"rival": 0.87, "refined_rival": 0.87}, {"correlation": 0.1, "rival": 0.1, "refined_rival": 0.1, "relief_m": 0.02}]
)
def test_what_was_answered_in_spite_of_doubt_has_the_refusal_that_it_would_have_been(other):
    evidence = replace(GOOD, **other)
    asked = answer(REFINED, evidence, PRIOR, 1.0)
    assert isinstance(asked, Registered)
    assert doubted(asked) == answer(REFINED, evidence, PRIOR, 0.05)


def test_a_method_of_ones_own_may_name_more_evidence():
    asked = answer(REFINED, replace(GOOD, rival=0.87, refined_rival=0.87), PRIOR, 1.0)
    assert isinstance(asked, Registered)
    more = replace(asked, evidence=(*asked.evidence, ("of_its_own", 1.0)))
    assert doubted(more).reason is doubted(asked).reason is Reason.AMBIGUOUS


def test_growth_widens_the_height_alone():
    before = answer(REFINED, GOOD, PRIOR, 1.0)
    after = answer(REFINED, GOOD, replace(PRIOR, sigma_growth_m=2.0), 1.0)
    assert isinstance(before, Registered)
    assert isinstance(after, Registered)
    np.testing.assert_array_equal(after.covariance_m2[:2, :2], before.covariance_m2[:2, :2])
    assert after.covariance_m2[2, 2] - before.covariance_m2[2, 2] == pytest.approx(4.0)
