"""The way out of LOST: how many fixes it takes, where they have to lie, and what comes of a lone one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.core.places.regaining import FORGET_NS, Regaining, hits_needed
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.core.settings import CoreSettings, InjectionSettings, NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import (
    Fix,
    GeoPoint,
    Injection,
    LinkChanged,
    LocaliseRequest,
    Mode,
    NavState,
    OperatorFix,
    Vec2,
)

World = Any
S = 1_000_000_000
ORIGIN = GeoPoint(47.0, 8.0, 400.0)
HEIGHT_M, RADIUS_M = 120.0, 2000.0
SPEED_MPS = 10.0
JAMMED_S, SEES_AGAIN_S = 20.0, 130.0


def fix(t_s: float, at_ne_m: Vec2, sigma_m: float = 1.5) -> Fix:
    place, level = wgs84.geo_from_ned((*at_ne_m, -HEIGHT_M), ORIGIN), (1.0, 0.0, 0.0, 0.0)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    return Fix(round(t_s * S), round(t_s * S), 1, 1, "deep", place, level, cov, 1.5, 0.05, 0.002, 5.0, ())


def state(t_s: float, sigma_m: float = 100.0) -> NavState:
    cov, cov_v = ((sigma_m**2, 0.0), (0.0, 1.0)), ((1.0, 0.0), (0.0, 1.0))
    return NavState(round(t_s * S), (0.0, 0.0, -HEIGHT_M), (SPEED_MPS, 0.0, 0.0), cov, 1.0, 60.0, cov_v)


def flying(until_s: float, speed_mps: float = SPEED_MPS) -> Regaining:
    """Northwards since t = 0."""
    travel = TravelLog()
    for k in range(round(10 * until_s) + 1):
        travel.velocity(k * S // 10, (speed_mps, 0.0))
    return Regaining(travel)


def seen(asked: Regaining, *fixes: tuple[float, Vec2], sigma_m: float = 100.0) -> list[bool]:
    """Whether each fix, a time and a place, waits."""
    return [asked.waits(fix(t_s, at), state(t_s, sigma_m), ORIGIN, RADIUS_M) for t_s, at in fixes]


def test_a_fix_waits_for_one_that_lies_where_the_motion_leads() -> None:
    assert seen(flying(60.0), (50.0, (300.0, 0.0)), (53.5, (335.0, 2.0))) == [True, False]


def test_a_second_look_at_the_same_ground_says_no_more() -> None:
    """A quarter of the height is 30 m."""
    assert seen(flying(60.0), (50.0, (300.0, 0.0)), (51.0, (310.0, 0.0)), (52.0, (320.0, 0.0))) == [True] * 3
    assert seen(flying(60.0, 0.0), *((50.0 + k, (300.0, 0.0)) for k in range(5))) == [True] * 5


def test_from_a_summit_it_is_the_height_over_the_valley_that_counts() -> None:
    """600 m over it, a quarter is 150 m."""
    asked = flying(70.0)
    fixes = [replace(fix(50.0 + k, (300.0 + 10 * k, 0.0)), above_ground_m=5 * HEIGHT_M) for k in (0, 4, 14, 16)]
    assert [asked.waits(each, state(each.t_ns / S), ORIGIN, RADIUS_M) for each in fixes] == [True, True, True, False]


def test_lone_fixes_here_and_there_end_nothing() -> None:
    places = [(300.0, 0.0), (-200.0, 150.0), (40.0, -260.0), (500.0, 90.0), (300.0, 0.0)]
    assert seen(flying(80.0), *((50.0 + 5 * k, place) for k, place in enumerate(places))) == [True] * 5


def test_a_false_fix_in_between_takes_nothing_from_those_that_agree() -> None:
    assert seen(flying(60.0), (50.0, (300.0, 0.0)), (52.0, (-100.0, 0.0)), (54.0, (340.0, 0.0))) == [True, True, False]


def test_two_places_that_were_seen_as_often_leave_it_open() -> None:
    """A copy of the ground 400 m beside: whichever is seen more often than the other is right."""
    beside = [(50.0 + 4 * k, (300.0 + 40 * k, east)) for k in range(3) for east in (0.0, 400.0)]
    assert seen(flying(70.0), *beside, sigma_m=300.0) == [True] * 4 + [False, True]


def test_what_was_seen_too_long_ago_counts_no_more() -> None:
    later_s = 50.0 + FORGET_NS / S + 1.0
    assert seen(flying(80.0), (50.0, (300.0, 0.0)), (later_s, (510.0, 0.0))) == [True, True]
    asked = flying(60.0)
    seen(asked, (50.0, (300.0, 0.0)))
    assert asked.waiting
    asked.clear()
    assert not asked.waiting
    assert seen(asked, (53.5, (335.0, 0.0))) == [True]


def test_the_wider_the_search_the_more_have_to_agree() -> None:
    assert [hits_needed(sigma_m, 960.0) for sigma_m in (31.0, 160.0, 161.0, 320.0, 321.0)] == [2, 2, 3, 3, 4]


def lost(
    world: type[World], blind_again: Callable[[float], bool] = lambda t: False, first_beside_m: float | None = None
) -> World:
    """Blind for so long that the daemon is lost, 300 m and more off; the first fix after that lies so far beside where it
    believes to be, None: where the vehicle is, as all others."""

    class Lost(world):  # type: ignore[misc]
        seen_again = False

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            if self.t >= SEES_AGAIN_S and isinstance(found, Fix):
                if first_beside_m is not None and not self.seen_again:
                    place = wgs84.geo_from_ned((first_beside_m, 0.0, 0.0), request.prior.place)
                    self.answers[-1] = (when, replace(found, place=place))
                self.seen_again = True

    w = Lost(
        settings=CoreSettings(injection=InjectionSettings(switch_source=True), structure=False),
        jammed=lambda t: t > JAMMED_S,
        blind=lambda t: JAMMED_S - 1 < t < SEES_AGAIN_S or blind_again(t),
        accel_bias_mps2=(0.01, -0.01),
    )
    w.start()
    return w


def test_a_lone_wrong_fix_does_not_end_a_loss(world: type[World]) -> None:
    """One, and nothing else for 10 s: it was taken, and positions were sent 400 m off."""
    w = lost(world, lambda t: SEES_AGAIN_S + 0.6 < t < 140.0, first_beside_m=100.0).fly(150)
    sent = [error for t, status, error in w.statuses if status.mode is Mode.AIDING and t > SEES_AGAIN_S]
    assert sent
    assert max(sent) < 10.0
    assert w.notices("a place is seen, fly on to confirm it") == [pytest.approx(SEES_AGAIN_S, abs=1.5)]


def test_right_fixes_end_a_loss_within_seconds(world: type[World]) -> None:
    w = lost(world).fly(140)
    assert w.status_at(SEES_AGAIN_S - 0.1)[0].mode is Mode.LOST
    found_s = min(t for t, status, _ in w.statuses if t > SEES_AGAIN_S and status.mode is Mode.AIDING)
    assert found_s - SEES_AGAIN_S < 4.5, "a quarter of the height is flown within 2.5 s"
    assert w.status_at(140)[1] < 5.0


def test_one_fix_is_enough_where_the_operator_said_the_place(world: type[World]) -> None:
    """Over the ground below a vehicle that hovers no two fixes count; the word is the other one."""
    w = lost(world, lambda t: SEES_AGAIN_S + 0.6 < t < 140.0)
    w.fly(SEES_AGAIN_S - 1.0)
    assert w.status_at(SEES_AGAIN_S - 1.1)[0].mode is Mode.LOST
    w.send(OperatorFix(0, wgs84.geo_from_ned((float(w.p[0]), float(w.p[1]), 0.0), GeoPoint(59.3, 18.1, 40.0)), 50.0))
    w.fly(SEES_AGAIN_S + 6.0)
    assert w.notices("operator's position confirmed")
    assert w.notices("a place is seen, fly on to confirm it") == []
    assert w.status_at(SEES_AGAIN_S + 1.5)[0].mode is Mode.AIDING


def test_a_link_that_is_away_ends_no_loss(world: type[World]) -> None:
    """WAITING is not LOST, but nothing is known better: the answer that was under way was taken, and positions were sent."""
    w = lost(world, lambda t: SEES_AGAIN_S + 0.6 < t < 145.0, first_beside_m=100.0).fly(SEES_AGAIN_S - 0.5)
    w.latency_s = 3.0
    while not w.seen_again:
        w.step()
    hears = w._telemetry
    w._telemetry = lambda *_: None
    w.send(LinkChanged(0, up=False))
    w.fly(w.t + 5.0)
    w._telemetry = hears
    w.start()
    w.fly(144.0)
    assert not [c for t, c in w.commands if isinstance(c, Injection) and t > SEES_AGAIN_S]
    assert w.status_at(143.9)[0].mode is Mode.LOST


def test_fixes_that_the_filter_refuses_at_first_are_not_asked_to_agree_again() -> None:
    """Its sigma grows meanwhile, and with it how many would have to agree."""
    asked = flying(70.0)
    assert seen(asked, (50.0, (300.0, 0.0)), (53.5, (335.0, 0.0)), sigma_m=150.0) == [True, False]
    assert seen(asked, (54.0, (340.0, 0.0)), sigma_m=170.0) == [False]


def test_where_the_origin_moves_fixes_of_before_tell_nothing() -> None:
    """Their metres are about another one: a false fix that the move alone brings to where the motion leads would end the loss."""
    asked = flying(70.0)
    assert seen(asked, (50.0, (300.0, 0.0))) == [True]
    moved = wgs84.geo_from_ned((-400.0, 0.0, 0.0), ORIGIN)
    assert asked.waits(fix(54.0, (-60.0, 0.0)), state(54.0), moved, RADIUS_M)
    assert not asked.waits(fix(58.0, (-20.0, 0.0)), state(58.0), moved, RADIUS_M), "of one origin again"


def test_where_the_origin_changes_its_height_fixes_of_before_tell_as_much() -> None:
    asked = flying(70.0)
    assert seen(asked, (50.0, (300.0, 0.0))) == [True]
    raised = replace(ORIGIN, h_amsl_m=ORIGIN.h_amsl_m + 0.04)
    assert not asked.waits(fix(54.0, (340.0, 0.0)), state(54.0), raised, RADIUS_M)


def test_a_map_that_is_known_poorly_does_not_keep_a_vehicle_lost(world: type[World]) -> None:
    """All states claim 8 m for the map, more than half of what a vehicle is lost with: however good fixes were, it stayed so."""
    limits = NavigatorSettings(map_sigma_m=8.0, lost_sigma_m=15.0)
    settings = CoreSettings(navigator=limits)
    w = world(settings=settings, jammed=lambda t: t > 20, blind=lambda t: 30 < t < 60)
    w.start()
    w.fly(80.0)
    assert w.status_at(59.9)[0].mode is Mode.LOST
    assert w.status_at(79.9)[0].mode is Mode.AIDING
    assert all(off_m < s.protection_level_m for t, s, off_m in w.statuses if t > 62)
