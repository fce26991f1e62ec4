"""Soundings along the track: what is kept, when it is asked about, and what may go into the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.terrain.terrain_aiding import FAR_SIGMA_M, METHOD, SHORTEST_M, SPACING_M, TerrainAiding
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import Fix, GeoPoint, NavState, NoFix, PosePrior, Quat, Range, TerrainRequest

ORIGIN = GeoPoint(47.0, 8.0, 400.0)
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
SPEED_MPS, AGL_M, STEP_S = 20.0, 100.0, 0.1
PRIOR = PosePrior(ORIGIN, LEVEL, ((100.0, 0.0), (0.0, 100.0)), 2.0, 0.05, 0.02)


def ns(t_s: float) -> int:
    return round(t_s * 1e9)


def flown(
    aiding: TerrainAiding, start_s: float, end_s: float, q: Quat = LEVEL, drive: Drive = Drive.AUTOPILOT, valid: bool = True
) -> None:
    """Due north at a constant height over ground at 400 m above the sea, a distance with every velocity."""
    for k in range(round(start_s / STEP_S), round(end_s / STEP_S)):
        t = ns(k * STEP_S)
        aiding.drive(Velocity(t, (SPEED_MPS, 0.0, 0.0), 500.0, 0.3, drive))
        aiding.on_range(Range(t, t, AGL_M, valid), t, q)


def asked(aiding: TerrainAiding, t_s: float, number: int = 1, prior: PosePrior = PRIOR) -> TerrainRequest:
    request = aiding.request(number, ns(t_s), prior, 0.8, steady=False)
    assert request is not None
    return request


def no_fix(request: TerrainRequest) -> NoFix:
    return NoFix(0, request.t_ns, request.request_id, 0, METHOD, Reason.LOW_TEXTURE, 1.0)


def fix(request: TerrainRequest, north_m: float = 0.0) -> Fix:
    place, cov = geo_from_ned((north_m, 0.0, 0.0), ORIGIN), ((25.0, 0.0), (0.0, 25.0))
    return Fix(0, request.t_ns, request.request_id, 0, METHOD, place, LEVEL, cov, 1.0, 0.05, 0.01, 1.0)


def far() -> PosePrior:
    return replace(PRIOR, cov_ne_m2=((4 * FAR_SIGMA_M**2, 0.0), (0.0, 1.0)))


def test_a_stretch_is_asked_about_when_it_is_long_enough() -> None:
    aiding, enough_s = TerrainAiding(), SHORTEST_M / SPEED_MPS
    flown(aiding, 0.0, enough_s - 1.0)
    assert not aiding.due(ns(enough_s - 1.1))
    assert aiding.request(1, ns(enough_s - 1.1), PRIOR, 0.8, steady=False) is None
    flown(aiding, enough_s - 1.0, enough_s + 1.0)
    request = asked(aiding, enough_s + 0.9)
    assert len(request.soundings) == pytest.approx(SHORTEST_M / SPACING_M, abs=5)
    age_s, north, east, up, *beam = request.soundings[0]
    assert north == pytest.approx(-SPEED_MPS * age_s, abs=0.02)
    assert (east, up, *beam) == (0.0, 0.0, 0.0, 0.0, -AGL_M)
    assert request.soundings[-1][0] < request.soundings[0][0]


def test_the_lowest_of_each_few_metres_is_kept() -> None:
    aiding = TerrainAiding()
    for k in range(400):
        t = ns(k * STEP_S)
        aiding.drive(Velocity(t, (SPEED_MPS, 0.0, 0.0), 500.0, 0.3, Drive.AUTOPILOT))
        aiding.on_range(Range(t, t, AGL_M - (15.0 if k % 2 else 0.0), valid=True), t, LEVEL)
    assert {row[6] for row in asked(aiding, 39.9).soundings} == {-AGL_M}


def test_a_tilted_beam_meets_the_ground_aside_and_a_steep_one_is_left_out() -> None:
    aiding, roll = TerrainAiding(), math.radians(20)
    flown(aiding, 0.0, 40.0, quat_from_euler(roll, 0.0, 0.0))
    beam = asked(aiding, 39.9).soundings[0][4:]
    assert beam == pytest.approx((0.0, -AGL_M * math.sin(roll), -AGL_M * math.cos(roll)), abs=0.01)
    steep = TerrainAiding()
    flown(steep, 0.0, 60.0, quat_from_euler(math.radians(30), 0.0, 0.0))
    assert not steep.due(ns(59.9))


def test_a_jump_of_the_autopilots_height_does_not_bend_the_stretch() -> None:
    aiding, enough_s = TerrainAiding(), SHORTEST_M / SPEED_MPS + 10
    for k in range(round(enough_s / STEP_S)):
        t = ns(k * STEP_S)
        aiding.drive(Velocity(t, (SPEED_MPS, 0.0, 0.0), 500.0 if k * STEP_S < enough_s / 2 else 510.0, 0.3, Drive.AUTOPILOT))
        aiding.on_range(Range(t, t, AGL_M, True), t, LEVEL)
    rows = asked(aiding, enough_s - STEP_S).soundings
    assert {row[3] for row in rows} == {0.0}


def test_what_did_not_come_back_is_no_sounding() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 60.0, valid=False)
    assert not aiding.due(ns(59.9))


def test_a_refused_stretch_is_joined_with_what_comes() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    first = asked(aiding, 39.9)
    assert not aiding.due(ns(39.9)), "one question at a time"
    assert aiding.answered(no_fix(first)) is None
    assert not aiding.due(ns(39.9)), "nothing new to ask"
    flown(aiding, 40.0, 55.0)
    second = asked(aiding, 54.9, 2)
    assert second.soundings[0][0] == pytest.approx(first.soundings[0][0] + 15.0)


def test_an_accepted_stretch_is_not_used_again() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    request = asked(aiding, 39.9)
    flown(aiding, 40.0, 42.0)
    answer = fix(request)
    assert aiding.answered(answer) is answer
    flown(aiding, 42.0, 75.0)
    assert asked(aiding, 74.9, 2).soundings[0][0] < 35.2


def test_from_far_off_a_first_answer_waits_for_one_that_agrees() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    assert aiding.answered(fix(asked(aiding, 39.9, 1, far()))) is None
    flown(aiding, 40.0, 80.0)
    elsewhere = fix(asked(aiding, 79.9, 2, far()), north_m=3000.0)
    assert aiding.answered(elsewhere) is None
    flown(aiding, 80.0, 120.0)
    agreeing = fix(asked(aiding, 119.9, 3, far()), north_m=3000.0 + 40.0 * SPEED_MPS)
    assert aiding.answered(agreeing) is agreeing


def test_a_longest_stretch_is_matched_whatever_it_promises() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 395.0)
    assert asked(aiding, 394.9).final


def test_of_a_track_that_is_longer_than_that_the_last_of_it_is_asked_about() -> None:
    for speed_mps, longest_s in ((SPEED_MPS, 400.0), (40.0, 200.0)):
        aiding = TerrainAiding()
        for k in range(5000):
            t = ns(k * STEP_S)
            aiding.drive(Velocity(t, (speed_mps, 0.0, 0.0), 500.0, 0.3, Drive.AUTOPILOT))
            aiding.on_range(Range(t, t, AGL_M, valid=True), t, LEVEL)
        age_s = asked(aiding, 499.9).soundings[0][0]
        assert longest_s - 1.0 < age_s <= longest_s


def test_another_velocity_or_a_gap_begins_anew() -> None:
    for change in ({"start_s": 40.0, "end_s": 42.0, "drive": Drive.FED_BACK}, {"start_s": 50.0, "end_s": 52.0}):
        aiding = TerrainAiding()
        flown(aiding, 0.0, 40.0)
        flown(aiding, **change)  # type: ignore[arg-type]
        assert not aiding.due(ns(change["end_s"] - 0.1))


def test_a_question_without_an_answer_is_given_up() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    request = asked(aiding, 39.9)
    aiding.abandoned(99)
    assert not aiding.due(ns(39.9))
    aiding.abandoned()
    assert aiding.due(ns(39.9))
    assert aiding.answered(fix(request)) is None


def test_a_velocity_that_led_astray_is_corrected_for_a_moment() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    answer = fix(asked(aiding, 39.9))
    state = NavState(answer.t_ns, (80.0, 0.0, -100.0), (SPEED_MPS, 0.0, 0.0), ((900.0, 0.0), (0.0, 900.0)), 1.0, 40.0)
    aiding.learn(answer, state, ORIGIN)
    north, east, down = aiding.corrected(answer.t_ns, (SPEED_MPS, 1.0, 0.0))
    assert SPEED_MPS - 2.0 < north < SPEED_MPS - 1.5
    assert (east, down) == (1.0, 0.0)
    assert aiding.corrected(answer.t_ns + ns(20.0), (SPEED_MPS, 1.0, 0.0))[0] == pytest.approx(SPEED_MPS, abs=1e-3)


def test_a_difference_within_the_fixs_own_sigma_teaches_nothing() -> None:
    aiding = TerrainAiding()
    flown(aiding, 0.0, 40.0)
    answer = fix(asked(aiding, 39.9))
    state = NavState(answer.t_ns, (3.0, 0.0, -100.0), (SPEED_MPS, 0.0, 0.0), ((900.0, 0.0), (0.0, 900.0)), 1.0, 40.0)
    aiding.learn(answer, state, ORIGIN)
    assert aiding.corrected(answer.t_ns, (SPEED_MPS, 0.0, 0.0)) == (SPEED_MPS, 0.0, 0.0)


def test_an_answer_to_a_track_that_has_ended_neither_delays_nor_confirms_the_next_one() -> None:
    enough_s = SHORTEST_M / SPEED_MPS + 2.0
    for prior, answer, given in ((PRIOR, no_fix, False), (PRIOR, fix, True), (far(), fix, False)):
        aiding = TerrainAiding()
        flown(aiding, 0.0, 100.0)
        request = asked(aiding, 99.9, prior=prior)
        flown(aiding, 110.0, 115.0)  # after a hole
        assert (aiding.answered(answer(request)) is not None) is given
        flown(aiding, 115.0, 110.0 + enough_s)
        again = asked(aiding, 109.9 + enough_s, number=2, prior=prior)
        assert (aiding.answered(fix(again)) is not None) is (prior is PRIOR)
