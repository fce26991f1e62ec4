"""The reasons why a match is declined, and what makes one doubtful."""

from __future__ import annotations

from dataclasses import replace

import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.terrain.base import Kind
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.verify import Evidence, probability_wrong, refusal

GOOD = Evidence(
    others=0.0,
    sigma_m=1.5,
    gain=150.0,
    reliability=0.98,
    sigma_ratio=0.9,
    ground=0.8,
    independent=60.0,
    position_sigmas=0.8,
    height_sigmas=0.5,
    known=1.0,
    converged=1.0,
)


def test_a_good_match_is_not_declined() -> None:
    p = probability_wrong(GOOD)
    assert p < 0.05
    assert refusal(GOOD, p, 1.5, Kind.PATCH, TerrainSettings()) is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"gain": 1.0}, Reason.LOW_TEXTURE),
        ({"reliability": 0.1}, Reason.LOW_TEXTURE),
        ({"sigma_m": 40.0}, Reason.LOW_TEXTURE),
        ({"position_sigmas": 6.0}, Reason.INCONSISTENT_WITH_PRIOR),
        ({"height_sigmas": 6.0}, Reason.INCONSISTENT_WITH_PRIOR),
        ({"converged": 0.0}, Reason.REFINEMENT_DIVERGED),
        ({"others": 0.4}, Reason.AMBIGUOUS),
    ],
)
def test_each_reason_has_its_evidence(change: dict[str, float], reason: Reason) -> None:
    evidence = replace(GOOD, **change)
    declined = refusal(evidence, probability_wrong(evidence), 1.5, Kind.PATCH, TerrainSettings())
    assert declined is not None
    assert declined[0] is reason


def test_a_doubtful_match_without_another_place_is_no_match() -> None:
    declined = refusal(GOOD, 0.5, 1.5, Kind.PATCH, TerrainSettings())
    assert declined is not None
    assert declined[0] is Reason.NO_MATCH


@pytest.mark.parametrize("change", [{"others": 0.3}, {"sigma_m": 9.0}, {"position_sigmas": 3.5}, {"ground": 0.1}])
def test_worse_evidence_is_more_doubtful(change: dict[str, float]) -> None:
    assert probability_wrong(replace(GOOD, **change)) > probability_wrong(GOOD)


def test_the_posterior_of_other_places_is_a_lower_bound() -> None:
    assert probability_wrong(replace(GOOD, others=0.5)) >= 0.5


def test_a_match_may_claim_more_where_soundings_count_alike_and_no_more_where_they_do_not() -> None:
    limit = TerrainSettings().max_sigma_m
    settled_well = replace(GOOD, sigma_m=1.2 * limit)
    assert refusal(settled_well, 0.01, 0.7 * limit, Kind.PROFILE, TerrainSettings()) is None
    for evidence, claimed_m in ((settled_well, 1.1 * limit), (replace(GOOD, sigma_m=1.4 * limit), 0.7 * limit)):
        declined = refusal(evidence, 0.01, claimed_m, Kind.PROFILE, TerrainSettings())
        assert declined is not None
        assert declined[0] is Reason.LOW_TEXTURE


def test_a_patch_over_even_ground_is_judged_by_what_it_claims_and_a_line_by_what_soundings_claim_that_count_alike() -> None:
    even = replace(GOOD, sigma_m=20.0)
    assert refusal(even, 0.05, 6.0, Kind.PATCH, TerrainSettings()) is None
    for claimed_m, kind in ((6.0, Kind.PROFILE), (11.0, Kind.PATCH)):
        declined = refusal(even, 0.05, claimed_m, kind, TerrainSettings())
        assert declined is not None
        assert declined[0] is Reason.LOW_TEXTURE
