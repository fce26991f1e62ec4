from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.structure.claims import (
    ENOUGH_NATS,
    HELD_M,
    LEAST_OVERLAP,
    LOOSE_M,
    MOST_BOWL_M,
    MOST_HELD_M,
    judged,
)


def registered(
    correlation: float,
    rival: float,
    handicap: float = 0.0,
    overlap: float = 1.0,
    formal_sigma_m: float = 0.3,
    bowl_m: float = 0.4,
    blocks_lead: float = ENOUGH_NATS,
    unchanged_lead: float = 0.0,
) -> Registered:
    named = {
        "correlation": correlation,
        "overlap": overlap,
        "handicap": handicap,
        "refined_rival": rival,
        "formal_sigma_m": formal_sigma_m,
        "bowl_m": bowl_m,
        "blocks_lead": blocks_lead,
        "unchanged_lead": unchanged_lead,
    }
    return Registered(np.eye(4), np.eye(3), 0.01, 0.01, 0.5, tuple(named.items()))


def probability(*given: float) -> float:
    found = judged(registered(*given), 1.0)
    assert isinstance(found, Registered)
    return found.probability_wrong


def test_a_place_far_ahead_of_the_next_is_believed_and_one_that_is_not_is_refused() -> None:
    assert probability(0.7, 0.3) < 0.001
    found = judged(registered(0.4, 0.39), 0.05)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.AMBIGUOUS
    assert dict(found.evidence)["probability_wrong"] > 0.05


def test_lead_overlap_and_nearness_to_the_prior_make_a_place_likelier() -> None:
    assert probability(0.45, 0.35) < probability(0.40, 0.35)
    assert probability(0.45, 0.35, 0.0, 1.0) < probability(0.45, 0.35, 0.0, 0.8)
    assert probability(0.45, 0.35, 0.01) == pytest.approx(probability(0.44, 0.35))


def test_a_place_that_nothing_holds_is_refused_however_far_it_leads() -> None:
    found = judged(registered(0.7, 0.3, formal_sigma_m=1.1 * LOOSE_M), 1.0)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.LOW_TEXTURE


@pytest.mark.parametrize("overlap", [0.97 * LEAST_OVERLAP, 1.03 * LEAST_OVERLAP])
def test_a_cloud_that_hangs_over_the_maps_edge_is_not_believed(overlap: float) -> None:
    found = judged(registered(0.7, 0.1, overlap=overlap), 1.0)
    assert isinstance(found, NotRegistered) is (overlap < LEAST_OVERLAP)
    if isinstance(found, NotRegistered):
        assert (found.reason, found.detail) == (Reason.OUTSIDE_MAP, "the map knows the ground below 58% of the cloud")


def test_a_place_beside_much_that_could_not_be_compared_has_to_lead_by_more() -> None:
    def wrong(rival: float, unseen: float) -> float:
        seen = registered(0.45, rival)
        found = judged(replace(seen, evidence=(*seen.evidence, ("unseen", unseen))), 1.0)
        assert isinstance(found, Registered)
        return found.probability_wrong

    assert wrong(0.35, 0.0) == pytest.approx(probability(0.45, 0.35))
    assert wrong(0.35, 0.0) < 0.05 < wrong(0.35, 0.5)
    assert wrong(0.3, 0.5) < 0.05


def test_a_place_that_is_held_loosely_has_to_lead_by_more() -> None:
    held, loose = probability(0.45, 0.35, 0.0, 1.0, HELD_M), probability(0.45, 0.35, 0.0, 1.0, 0.9 * LOOSE_M)
    assert held == probability(0.45, 0.35, 0.0, 1.0, 0.1)
    assert held < 0.05 < loose
    assert probability(0.55, 0.35, 0.0, 1.0, 0.9 * LOOSE_M) < 0.05


@pytest.mark.parametrize("bend", [1.1, -1.1])
def test_a_place_that_only_a_bent_cloud_fits_is_refused_however_far_it_leads(bend: float) -> None:
    found = judged(registered(0.7, 0.3, bowl_m=bend * MOST_BOWL_M), 1.0)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.INCONSISTENT_WITH_PRIOR
    assert isinstance(judged(registered(0.7, 0.3, bowl_m=bend * MOST_BOWL_M / 1.2), 1.0), Registered)


def test_a_place_that_unchanged_blocks_do_not_favour_over_those_beside_is_refused() -> None:
    """Seed 131, case 4 of benchmarks/changed_land.py: 10 m off, claimed 0.7 m, 0.15 ahead of all others."""
    odd = judged(registered(0.179, 0.0, 0.029, formal_sigma_m=0.44, bowl_m=-0.41, blocks_lead=9.1), 0.05)
    assert isinstance(odd, NotRegistered)
    assert odd.reason is Reason.AMBIGUOUS


def test_what_blocks_lack_counts_against_a_place_and_more_than_enough_counts_for_none() -> None:
    wrong = [probability(0.45, 0.35, 0.0, 1.0, 0.3, 0.4, nats) for nats in (6.0, 10.0, ENOUGH_NATS, 10 * ENOUGH_NATS)]
    assert wrong[0] > wrong[1] > wrong[2] == wrong[3]
    assert wrong[2] < 0.05 < wrong[0]


@pytest.mark.parametrize("lead", [20.0, 100.0])
@pytest.mark.parametrize(
    ("formal_sigma_m", "bowl_m", "reason"),
    [
        (0.3, 0.4, Reason.AMBIGUOUS),
        (1.1 * LOOSE_M, 0.4, Reason.LOW_TEXTURE),
        (0.3, 1.1 * MOST_BOWL_M, Reason.INCONSISTENT_WITH_PRIOR),
    ],
)
def test_all_that_has_not_changed_is_believed_where_the_score_is_not(
    lead: float, formal_sigma_m: float, bowl_m: float, reason: Reason
) -> None:
    found = judged(registered(0.1, 0.1, 0.0, 1.0, formal_sigma_m, bowl_m, 0.0, lead), 0.05)
    assert isinstance(found, Registered) is (lead > 60)
    if isinstance(found, NotRegistered):
        assert found.reason is reason


def test_a_place_that_hardly_anything_holds_is_refused_whatever_has_not_changed() -> None:
    found = judged(registered(0.7, 0.3, formal_sigma_m=1.1 * MOST_HELD_M, unchanged_lead=500.0), 0.05)
    assert isinstance(found, NotRegistered)
    assert found.reason is Reason.LOW_TEXTURE


def test_a_place_that_the_score_makes_sure_needs_no_lead_of_what_has_not_changed() -> None:
    assert probability(0.7, 0.3, 0.0, 1.0, 0.3, 0.4, ENOUGH_NATS, 1.0) == probability(0.7, 0.3)
