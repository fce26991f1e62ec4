"""From a start to an answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.registration import settle
from visloc_companion.localise.registration.base import NotRegistered, Registered
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.search import find_places
from visloc_companion.localise.registration.settle import Settler, judged
from visloc_companion.localise.registration.similarity import moved


def test_how_far_a_candidate_slid_is_counted_from_where_it_started(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    start = scene.T_true.copy()
    start[0, 3] += 1.5
    settler = Settler(pair, scene.prior)
    settled = settler.settle(start)
    last = settler.polished(settled)
    for one in (settled, last):
        off = moved(one.refined.T, pair.centre_m)[:2] - moved(start, pair.centre_m)[:2]
        assert one.slid_m == pytest.approx(np.hypot(*off))
    assert last.slid_m == pytest.approx(1.5, abs=0.3)


def test_last_steps_that_lose_the_relief_are_taken_back(scene, monkeypatch):
    settler = Settler(make_pair(scene.source_m, scene.reference_m, scene.prior), scene.prior)
    settled = settler.settle(scene.T_true)
    astray = settled.refined.T.copy()
    astray[0, 3] += 5.0
    monkeypatch.setattr(settle, "polish", lambda *_: replace(settled.refined, T=astray))
    assert settler.polished(settled) is settled


def test_a_refined_place_is_compared_with_others_by_their_refined_scores(scene):
    pair = make_pair(scene.source_m, scene.reference_m, scene.prior)
    places, scores = find_places(pair, scene.prior, 3)
    settler = Settler(pair, scene.prior)
    best, *rest = [settler.settle(place.T) for place in places]
    found = settler.answer(best, rest, scores, settler.headings(best), 1.0)
    evidence = dict(found.evidence)
    assert evidence["refined_rival"] <= evidence["rival"]
    assert evidence["refined_rival"] >= max(s.found.score for s in rest)


def test_a_found_similarity_is_judged_as_it_is(scene):
    found = judged(lambda source, reference: scene.T_true, (scene.source_m, scene.reference_m), scene.prior, 1.0)
    assert isinstance(found, Registered)
    np.testing.assert_array_equal(found.T_reference_source, scene.T_true)


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), np.zeros((4, 4))])
def test_what_is_no_similarity_is_refused(scene, T):
    found = judged(lambda source, reference: T, (scene.source_m, scene.reference_m), scene.prior, 1.0)
    assert isinstance(found, NotRegistered)
    assert found.reason == Reason.NO_MATCH


def test_a_similarity_to_elsewhere_has_too_little_overlap(scene):
    T = np.eye(4)
    T[0, 3] = 5000.0
    found = judged(lambda source, reference: T, (scene.source_m, scene.reference_m), scene.prior, 1.0)
    assert isinstance(found, NotRegistered)
    assert found.reason == Reason.LOW_OVERLAP
