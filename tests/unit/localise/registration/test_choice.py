"""Which candidate is taken, and when the finer relief is searched too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.localise.registration.conftest import cloud, terrain
from visloc_companion.errors import Reason
from visloc_companion.localise.flight import flight_registration
from visloc_companion.localise.registration import choice, height_search
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.choice import CLEAR_LEAD, Choice
from visloc_companion.localise.registration.height_search import HeightSearchRegistration
from visloc_companion.localise.registration.leads import leads_of, parts_z
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.search import find_places, work
from visloc_companion.localise.registration.settle import Settler
from visloc_companion.localise.registration.similarity import moved

DECOY_M = np.array([-30.0, 22.0])
PRIOR = RegistrationPrior(20.0, 3.0, np.radians(1.0), np.radians(0.5), 0.005)


def with_tower(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    raised = points.copy()
    raised[(np.abs(raised[:, :2] - middle) < 2.5).all(1), 2] += 4.0
    return raised


@pytest.fixture(scope="module")
def faint() -> tuple[np.ndarray, np.ndarray]:
    """Source and reference of faint ground, where the source lies right: a tower was built since, and a like one stands where
    the source would lie by DECOY_M aside."""
    rng, heights = np.random.default_rng(6), terrain(9, 200)
    low = lambda xy: 0.13 * heights(xy)  # noqa: E731
    reference, source = cloud(low, rng, np.zeros(2), 150, 3.0, 0.02), cloud(low, rng, np.zeros(2), 60, 3.0, 0.02)
    tower = np.array([9.0, -6.0])
    return with_tower(source, tower), with_tower(reference, tower + DECOY_M)


def off_m(found: object, source: np.ndarray) -> np.ndarray:
    assert isinstance(found, Registered)
    return (moved(found.T_reference_source, source) - source).mean(0)[:2]


def test_the_place_that_all_looks_favour_is_taken_where_a_single_thing_makes_the_score(faint):
    source, reference = faint
    by_score, by_looks = (HeightSearchRegistration(1.0, by_score=by)(source, reference, PRIOR) for by in (True, False))
    assert np.hypot(*(off_m(by_score, source) - DECOY_M)) < 3
    assert np.hypot(*off_m(by_looks, source)) < 1


def test_the_vote_in_flight_is_chosen_by_the_score_that_its_claims_rest_on():
    assert flight_registration().by_score


@pytest.fixture
def searched(monkeypatch):
    """The pairs that were searched."""
    pairs = []

    def recorded(pair, prior, most):
        pairs.append(pair)
        return find_places(pair, prior, most)

    for module in (height_search, choice):
        monkeypatch.setattr(module, "find_places", recorded)
    return pairs


def test_the_finer_relief_is_searched_where_the_place_is_doubtful_and_there_alone(scene, searched):
    HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert len(searched) == 1
    searched.clear()
    mirrored = scene.source_m * [1, -1, 1]
    HeightSearchRegistration(1.0)(mirrored, scene.reference_m, scene.prior)
    assert len(searched) == 2
    np.testing.assert_array_equal(searched[1].source_relief.height_m, searched[0].finer.source_relief.height_m)


def test_nothing_is_searched_twice_by_score_nor_where_that_is_too_much_work(scene, searched):
    mirrored = scene.source_m * [1, -1, 1]
    cost = work(make_pair(mirrored, scene.reference_m, scene.prior), scene.prior)
    HeightSearchRegistration(1.0, by_score=True)(mirrored, scene.reference_m, scene.prior)
    HeightSearchRegistration(1.0, 1.9 * cost)(mirrored, scene.reference_m, scene.prior)
    assert len(searched) == 2
    HeightSearchRegistration(1.0, 2.1 * cost)(mirrored, scene.reference_m, scene.prior)
    assert len(searched) == 4


def test_last_steps_that_slide_away_are_taken_back(scene, monkeypatch):
    def slides(settler, found, prior):
        return replace(settler.polished(found), slid_m=10.0), []

    kept = HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    monkeypatch.setattr(height_search, "polished", slides)
    found = HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(found, Registered)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 0.3
    assert found.T_reference_source.tobytes() != kept.T_reference_source.tobytes()
    by_score = HeightSearchRegistration(1.0, by_score=True)(scene.source_m, scene.reference_m, scene.prior)
    assert isinstance(by_score, NotRegistered)
    assert by_score.reason == Reason.REFINEMENT_DIVERGED


def test_a_candidate_that_slid_is_taken_only_where_all_did(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    settler, chooses = Settler(pair, scene.prior), Choice(pair, scene.prior)
    right, other = (settler.settle(place.T) for place in find_places(pair, scene.prior, 2)[0])
    assert chooses.best([other, right]) is right
    slid = replace(right, slid_m=10.0)
    assert chooses.best([other, slid]) is other
    assert chooses.best([slid]) is slid


def test_parts_agree_at_the_right_place_and_see_nothing_beyond_the_region(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    beside, beyond = scene.T_true.copy(), scene.T_true.copy()
    beside[0, 3] += 9.0
    beyond[0, 3] += 500.0
    right, wrong, nothing = (parts_z(pair, T, scene.prior) for T in (scene.T_true, beside, beyond))
    assert right > 1.0 > wrong + 0.3
    assert nothing == 0


def test_a_place_is_doubted_that_leads_by_little_after_the_last_steps(scene, searched, monkeypatch):
    """Before them it led."""
    led = []

    def leads(pair, T, prior):
        led.append(leads_of(pair, T, prior))
        return replace(led[-1], joint=CLEAR_LEAD - 0.01) if len(led) == 2 else led[-1]

    monkeypatch.setattr(choice, "leads_of", leads)
    found = HeightSearchRegistration(1.0)(scene.source_m, scene.reference_m, scene.prior)
    assert (len(led), len(searched)) == (2, 2)
    assert isinstance(found, Registered)
    assert np.abs(scene.offset_m(found.T_reference_source).mean(0)).max() < 0.3
