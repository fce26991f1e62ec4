"""A place refined from two headings."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.registration.evidence import Agreement
from visloc_companion.localise.registration.handicap import NATS
from visloc_companion.localise.registration.pair import make_pair
from visloc_companion.localise.registration.refine import Refined
from visloc_companion.localise.registration.search import APART_M
from visloc_companion.localise.registration.settle import Settled, Settler
from visloc_companion.localise.registration.similarity import about, moved, scale_of, yaw_of
from visloc_companion.localise.registration.upright import polished

CENTRE = np.array([30.0, -10.0, 4.0])
HELD = CENTRE + np.array([80.0, 0.0, 0.0])
"""The relief of these places is all at one end: the source turns about it."""


def place(yaw: float, score: float, shift=(0.0, 0.0, 0.0)) -> Settled:
    """Turned about HELD, with the covariance that goes with that: 0.2 m of place, 0.02 rad of heading."""
    T = about(HELD, yaw, 1.0, np.array(shift))
    lever = np.array([0.0, -80.0, 1.0, 0.0])
    placed = 0.02**2 * np.outer(lever, lever) + np.diag([0.04, 0.04, 0.0, 1e-6])
    refined = Refined(T, 0.0, placed, np.eye(4), 0.1)
    return Settled(refined, Agreement(score, 1.0, 1.0, 1.0, 1.0, 0.0), moved(T, CENTRE)[:2], 0.0, yaw)


class Fake:
    """A settler that ends where it is told and remembers where it was started."""

    def __init__(self, ends: Settled | None) -> None:
        self.pair, self.ends, self.start = SimpleNamespace(centre_m=CENTRE, half_m=30.0), ends, np.eye(4)

    def settle(self, start):
        self.start = start
        return self.ends

    def polished(self, settled):
        return settled


def test_the_second_start_turns_about_what_holds_the_place(scene):
    fake = Fake(None)
    found = place(0.03, 0.6)
    best, others = polished(fake, found, replace(scene.prior, gaussian=True))
    assert (best, others) == (found, [])
    assert (yaw_of(fake.start), scale_of(fake.start)) == pytest.approx((0.0, 1.0))
    assert moved(fake.start, HELD)[:2] == pytest.approx(HELD[:2], abs=0.1)
    assert np.hypot(*(moved(fake.start, CENTRE) - moved(found.refined.T, CENTRE))[:2]) > 2


def test_the_better_of_two_headings_is_taken_and_what_they_differ_by_is_claimed(scene):
    prior = replace(scene.prior, gaussian=True)
    worse, better = place(0.03, 0.600), place(0.0, 0.605)
    for found, ends in ((worse, better), (better, worse)):
        best, others = polished(Fake(ends), found, prior)
        assert others == []
        np.testing.assert_array_equal(best.refined.T, better.refined.T)
        share = 1 / (1 + np.exp(NATS * 0.005))
        assert best.refined.placed[2, 2] == pytest.approx(0.02**2 + share * (1 - share) * 0.03**2)
        assert best.refined.placed[1, 1] == pytest.approx(0.04 + 1.6**2 + share * (1 - share) * (80 * np.sin(0.03)) ** 2)


def test_a_heading_that_agrees_far_worse_widens_nothing(scene):
    better = place(0.0, 0.8)
    best, _ = polished(Fake(place(0.03, 0.5)), better, replace(scene.prior, gaussian=True))
    np.testing.assert_allclose(best.refined.placed, better.refined.placed, atol=1e-6)


def test_another_place_is_a_rival(scene):
    found, elsewhere = place(0.0, 0.5), place(0.0, 0.6, (APART_M + 1, 0.0, 0.0))
    best, others = polished(Fake(elsewhere), found, replace(scene.prior, gaussian=True))
    assert best is found
    assert others == [elsewhere]


def test_the_same_place_turned_is_a_rival_and_no_spread_of_one_heading(scene):
    """As good turned by a right angle, it was taken and its heading held to 43 deg, with no word of the other."""
    found, turned = place(0.03, 0.5), place(0.0, 0.5)
    turned = replace(turned, refined=replace(turned.refined, T=about(CENTRE, np.pi / 2, 1.0, np.zeros(3))))
    best, others = polished(Fake(turned), found, replace(scene.prior, gaussian=True))
    assert best is found
    assert others == [turned]


def test_a_place_that_is_held_stays_and_a_uniform_prior_asks_no_second_time(scene):
    for gaussian in (True, False):
        prior = replace(scene.prior, gaussian=gaussian)
        settler = Settler(make_pair(scene.source_m, scene.reference_m, prior), prior)
        found = settler.settle(scene.T_true)
        best, others = polished(settler, found, prior)
        once = settler.polished(found)
        assert others == []
        np.testing.assert_allclose(best.refined.T, once.refined.T, atol=0.01 if gaussian else 0.0)
        np.testing.assert_allclose(best.refined.placed, once.refined.placed, atol=1e-3 if gaussian else 0.0)
