"""The operator's word is held against origin, GNSS and fixes, and only a localiser makes it a position to inject."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visloc_companion.core.places.operator_word import MARGIN_M, elsewhere, objection
from visloc_companion.core.settings import CoreSettings, NavigatorSettings
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, Injection, LocaliseRequest, Mode, NavState, NoFix, Odometry, OperatorFix

World = Any
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SEES_S = 20.0


def at(north_m: float) -> GeoPoint:
    return wgs84.geo_from_ned((north_m, 0.0, 0.0), ORIGIN)


def said(north_m: float, sigma_m: float = 5.0) -> OperatorFix:
    return OperatorFix(0, at(north_m), sigma_m)


def held(sigma_m: float) -> NavState:
    return NavState(0, (0.0, 0.0, -100.0), (0.0, 0.0, 0.0), ((sigma_m**2, 0.0), (0.0, sigma_m**2)), 5.0, 1.0)


@pytest.mark.parametrize(
    ("said", "origin", "receiver", "held", "why"),
    [
        (said(0.0), None, None, None, "no EKF origin yet"),
        (said(150_000.0), ORIGIN, None, None, "too far from origin"),
        (said(500.0), ORIGIN, at(0.0), None, "far from trusted GNSS"),
        (said(500.0), ORIGIN, at(490.0), None, None),
        (said(60.0), ORIGIN, at(0.0), None, None),
        (said(500.0), ORIGIN, None, held(3.0), "far from the fixes"),
        (said(500.0), ORIGIN, None, held(120.0), None),
        (said(500.0, 120.0), ORIGIN, None, held(3.0), None),
        (said(4 * 5.0 + 4 * 3.0 + MARGIN_M - 1.0), ORIGIN, None, held(3.0), None),
        (said(4 * 5.0 + 4 * 3.0 + MARGIN_M + 1.0), ORIGIN, None, held(3.0), "far from the fixes"),
    ],
)
def test_what_speaks_against_it(
    said: OperatorFix, origin: GeoPoint | None, receiver: GeoPoint | None, held: NavState | None, why: str | None
) -> None:
    assert objection(said, origin, receiver, held) == why


def true_place(w: World, north_m: float = 0.0) -> GeoPoint:
    return wgs84.geo_from_ned((float(w.p[0]) + north_m, float(w.p[1]), 0.0), ORIGIN)


@pytest.mark.parametrize("anywhere", [True, False])
def test_nothing_is_sent_before_a_localiser_has_found_the_vehicle_there(world: type[World], *, anywhere: bool) -> None:
    settings = CoreSettings(navigator=NavigatorSettings(start_anywhere=anywhere))
    w = world(settings=settings, jammed=lambda t: True, blind=lambda t: t < 20)
    w.start()
    w.fly(5)
    w.send(OperatorFix(0, true_place(w, 8.0), 10.0))
    assert w.notices("position taken, looking there")
    w.fly(19)
    assert w.first(Injection) == float("inf")
    assert not w.notices("position confirmed")
    w.fly(40)
    (confirmed_s,) = w.notices("operator's position confirmed")
    assert 20 < confirmed_s <= w.first(Injection) < 25
    assert w.status_at(39)[0].mode is Mode.AIDING


@pytest.mark.parametrize(("why", "times"), [(Reason.OUTSIDE_MAP, 2), (Reason.NO_MATCH, 0)])
def test_a_place_outside_the_map_is_named_once_a_word(world: type[World], why: Reason, times: int) -> None:
    w = world(jammed=lambda t: True, blind=lambda t: True, why_blind=why)
    w.start()
    w.fly(5)
    assert not w.notices("outside the map")
    for until_s in (9, 13):
        w.send(OperatorFix(0, true_place(w, 3000.0), 10.0))
        w.fly(until_s)
    assert len(w.notices("position taken, looking there")) == 2
    told = w.notices("visloc: stated position is outside the map")
    assert len(told) == times
    assert all(told_s < said_s + 1.0 for told_s, said_s in zip(told, (5, 9), strict=False))


def test_a_position_that_fixes_hold_is_not_moved_by_words(world: type[World]) -> None:
    flights = []
    for word_m in (None, 20.0, 900.0):
        w = world(jammed=lambda t: t > 15)
        w.start()
        w.fly(30)
        assert w.status_at(29)[0].mode is Mode.AIDING
        if word_m is not None:
            w.send(OperatorFix(0, true_place(w, word_m), 10.0))
        flights.append(w.fly(45))
    silent, near, far = flights
    assert near.notices("position agrees, nothing changed")
    assert far.notices("position refused, far from the fixes")
    positions = [[c.p_ned_m for _, c in w.commands if isinstance(c, Injection)] for w in flights]
    assert len(positions[0]) > 200
    assert positions[0] == positions[1] == positions[2]
    assert silent.status_at(44)[0].reset_counter == far.status_at(44)[0].reset_counter


def test_a_lost_vehicle_is_found_where_the_operator_says_and_sends_nothing_before(world: type[World]) -> None:
    w = world(
        jammed=lambda t: t > 20,
        blind=lambda t: 20 < t < 320,
        false_velocity_mps=lambda t: (3.0, 0.0) if t > 20 else (0.0, 0.0),
        speed_mps=5.0,
    )
    w.start()
    w.fly(300)
    status, _ = w.status_at(299)
    assert status.mode is Mode.LOST
    w.send(OperatorFix(0, true_place(w, 15.0), 20.0))
    w.fly(319)
    assert {w.status_at(t)[0].mode for t in range(302, 319)} <= {Mode.SHADOW, Mode.LOST}
    w.fly(345)
    assert w.notices("operator's position confirmed")
    after, error_m = w.status_at(344)
    assert after.mode is Mode.AIDING
    assert error_m < 8
    assert after.reset_counter != status.reset_counter


def test_fixes_far_from_where_the_operator_said_confirm_nothing(world: type[World]) -> None:
    w = world(jammed=lambda t: True, blind=lambda t: t < 12)
    w.start()
    w.fly(5)
    w.send(OperatorFix(0, true_place(w, 400.0), 10.0))
    w.fly(30)
    assert len(w.notices("visloc: relocalised")) == 1
    assert w.notices("operator's position confirmed") == []
    assert w.status_at(29)[1] < 8


def test_fixes_confirm_no_word_that_gnss_has_answered_since(world: type[World]) -> None:
    """The word is 50 m beside the place and a GNSS that is trusted came before any fix: what they confirm is GNSS."""
    w = world(jammed=lambda t: t < 8, blind=lambda t: t < 30)
    w.start()
    w.fly(5)
    w.send(OperatorFix(0, true_place(w, 50.0), 20.0))
    assert w.notices("position taken, looking there")
    w.fly(45)
    assert w.notices("GNSS trusted")
    assert (w.status_at(44)[0].age_of_fix_s or 99.0) < 2.0
    assert not w.notices("operator's position confirmed")


def test_rare_doubtful_fixes_confirm_an_operators_word_with_odometry_between_them(world: type[World]) -> None:
    """The word is good to 50 m; every twelfth second a fix that may be wrong with 4 %, and odometry all the time."""

    class Rare(world):  # type: ignore[misc]
        found_s = 0.0

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            t_ns, period_s = request.frame.t_ns, self.fix_period_s
            north, east = np.array(self.velocity(t_ns * 1e-9 - period_s / 2)) * period_s
            cov = ((0.01, 0.0), (0.0, 0.01))
            motion = Odometry(0, t_ns - round(period_s * 1e9), t_ns, (float(north), float(east), 0.0), cov, 0.01, 0.02)
            if isinstance(found, Fix) and self.t - self.found_s >= 12.0:
                self.found_s = self.t
                self.answers[-1] = (when, replace(found, probability_wrong=0.04, motion=motion))
            else:
                none = NoFix(found.t_rx_ns, t_ns, found.request_id, found.frame_id, "deep", Reason.AMBIGUOUS, 0.0)
                self.answers[-1] = (when, replace(none, motion=motion))

    w = Rare(jammed=lambda t: True, blind=lambda t: t < SEES_S, speed_mps=5.0)
    w.start()
    w.fly(5)
    w.send(OperatorFix(0, true_place(w, 30.0), 50.0))
    w.fly(80)
    assert len(w.notices("waits for a second one")) == 1
    (confirmed_s,) = w.notices("operator's position confirmed")
    assert SEES_S < confirmed_s < SEES_S + 30.0
    assert w.status_at(79)[1] < 8.0


def test_before_there_is_a_filter_no_fix_is_elsewhere_than_said() -> None:
    far = Fix(0, 0, 1, 1, "t", at(9000.0), (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.05, 0.001, 1.0)
    assert elsewhere(said(0.0), far, held(10.0), ORIGIN)
    assert not elsewhere(said(0.0), far, None, ORIGIN)
    assert not elsewhere(said(0.0), far, held(10.0), None)
