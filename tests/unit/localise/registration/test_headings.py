"""Other headings at a place that was found."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.unit.localise.registration.conftest import at_places, cloud, hills
from visloc_companion.errors import Reason
from visloc_companion.localise.registration.base import NotRegistered, Registered, RegistrationPrior
from visloc_companion.localise.registration.headings import Headings, are_two, headings_at, starts, wrapped
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.registry import make_registration
from visloc_companion.localise.registration.settle import judged
from visloc_companion.localise.registration.similarity import about, yaw_of

UNKNOWN = RegistrationPrior(20.0, 3.0, np.radians(60.0), np.radians(0.5), 0.012)


def alike(seed: int, fold: int):
    """Heights at places: crowns, roofs and hills about zero that are the same after a turn by 360 deg / `fold`."""
    grid = hills(seed, 201)
    return at_places(sum(np.rot90(grid, 4 // fold * k) for k in range(fold)) / np.sqrt(fold), 100)


def case(seed: int, fold: int, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Source, which is to be turned by `yaw` about zero, and reference."""
    rng, heights = np.random.default_rng(seed + 99), alike(seed, fold)
    reference, source = cloud(heights, rng, 0.0, 150, 3, 0.05), cloud(heights, rng, 0.0, 60, 3, 0.15)
    return source @ about(np.zeros(3), yaw, 1.0, np.zeros(3))[:3, :3], reference


def turn_deg(T: np.ndarray, yaw: float) -> float:
    return float(np.degrees(abs(wrapped(np.array(yaw_of(T) - yaw)))))


@pytest.mark.parametrize(("fold", "seed"), list(itertools.product((2, 4), (0, 3))))
def test_ground_that_is_alike_turned_is_ambiguous_where_the_heading_is_unknown(fold, seed):
    """Taken turned by 90 to 180 deg and claimed with a probability of being wrong of 0.0000 in 21 of 48 tries."""
    found = make_registration("height-search")(*case(seed, fold, 0.7), UNKNOWN)
    assert isinstance(found, NotRegistered)
    assert found.reason == Reason.AMBIGUOUS
    assert dict(found.evidence)["rival"] > 0.9


@pytest.mark.parametrize("fold", [2, 4])
def test_it_is_found_where_the_heading_is_known(fold):
    found = make_registration("height-search")(*case(3, fold, 0.05), replace(UNKNOWN, sigma_yaw_rad=np.radians(3.0)))
    assert isinstance(found, Registered)
    assert turn_deg(found.T_reference_source, 0.05) < 1
    assert found.probability_wrong < 0.01


@pytest.mark.parametrize("yaw", [-2.9, -1.6, 0.4, 3.1])
def test_other_ground_is_found_with_any_heading(yaw):
    source, reference = case(1, 1, yaw)
    found = make_registration("height-search")(source, reference, UNKNOWN)
    assert isinstance(found, Registered)
    assert turn_deg(found.T_reference_source, yaw) < 1
    assert found.probability_wrong < 0.01


def test_the_better_of_two_headings_is_taken():
    """Alike by half: what is refined decides."""
    source, reference = case(3, 2, 2.0)
    bump = 4.0 * (np.hypot(*(reference[:, :2] - [18.0, 6.0]).T) < 5.0)
    own = source @ about(np.zeros(3), 2.0, 1.0, np.zeros(3))[:3, :3].T
    on_own = 4.0 * (np.hypot(*(own[:, :2] - [18.0, 6.0]).T) < 5.0)
    reference[:, 2] += bump
    source[:, 2] += on_own
    found = make_registration("height-search", 1.0)(source, reference, UNKNOWN)
    assert isinstance(found, Registered)
    assert turn_deg(found.T_reference_source, 2.0) < 1
    evidence = dict(found.evidence)
    assert evidence["refined_rival"] < evidence["correlation"]


def test_a_similarity_of_another_method_is_judged_against_its_own_turned():
    source, reference = case(3, 2, 0.0)
    turned = about(np.zeros(3), np.pi, 1.0, np.zeros(3))
    for T in (np.eye(4), turned):
        found = judged(lambda *_, T=T: T, (source, reference), UNKNOWN, 1.0)
        assert isinstance(found, Registered)
        assert found.probability_wrong >= 0.5


def test_headings_that_are_one_are_not_looked_at(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    narrow = headings_at(pair, scene.T_true, replace(scene.prior, sigma_yaw_rad=0.01))
    assert not len(narrow.yaw_rad)
    assert narrow.rival([0.0], 0.1) == 0
    assert starts(pair, scene.T_true, narrow, 2) == []
    assert not len(headings_at(pair, scene.T_true, replace(UNKNOWN, sigma_horizontal_m=1.0)).yaw_rad)


def test_peaks_of_headings_are_away_from_their_own_and_go_around_the_circle():
    yaw = np.radians(np.arange(-175.0, 180.0, 10.0))
    score = 0.5 + 0.3 * np.cos(2 * yaw - 0.2) + 0.1 * np.cos(yaw)
    around = Headings(yaw, score, np.zeros((len(yaw), 2)), True)
    assert list(np.flatnonzero(around.away_from([0.1], 0.3))) == [0 if score[0] > score[-1] else len(yaw) - 1]
    assert around.rival([0.1, np.pi], 0.3) == 0
    ends = Headings(yaw, -np.abs(yaw) + 9, np.zeros((len(yaw), 2)), False)
    assert not ends.away_from([0.0], 0.3).any()


def test_two_are_two_by_place_or_by_heading(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    here = about(pair.centre_m, 0.1, 1.0, np.zeros(3))
    assert not are_two(pair, here, about(pair.centre_m, 0.2, 1.0, np.array([3.0, 0, 0])))
    assert are_two(pair, here, about(pair.centre_m, 0.1, 1.0, np.array([7.0, 0, 0])))
    assert are_two(pair, here, about(pair.centre_m, 0.4, 1.0, np.zeros(3)))
    assert not are_two(pair, about(pair.centre_m, np.pi, 1.0, np.zeros(3)), about(pair.centre_m, -np.pi + 0.01, 1.0, np.zeros(3)))
