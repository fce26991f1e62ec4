"""Fixes that may well be wrong and would carry the filter far: alone, and from the worker's answer to the filter."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.core.filter.second_opinion import SecondOpinion
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, LocaliseRequest, Mode, NavState, Vec2

World = Any
S = 1_000_000_000
ORIGIN = GeoPoint(47.0, 8.0, 400.0)
JAMMED_S, SEES_AGAIN_S, WRONG_M = 20.0, 50.0, 13.0


def fix(t_s: float, at_ne_m: Vec2, wrong: float = 0.04, sigma_m: float = 1.5) -> Fix:
    place, level = wgs84.geo_from_ned((*at_ne_m, -100.0), ORIGIN), (1.0, 0.0, 0.0, 0.0)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    return Fix(round(t_s * S), round(t_s * S), 1, 1, "deep", place, level, cov, 1.5, 0.05, wrong, 5.0, ())


def state(t_s: float, at_ne_m: Vec2 = (0.0, 0.0), sigma_m: float = 10.0) -> NavState:
    cov = ((sigma_m**2, 0.0), (0.0, 1.0))
    return NavState(round(t_s * S), (*at_ne_m, -100.0), (10.0, 0.0, 0.0), cov, 1.0, 30.0)


def test_a_doubtful_fix_waits_until_one_agrees_with_it() -> None:
    asked = SecondOpinion()
    assert asked.waits(fix(60.0, (13.0, 0.0)), state(60.0), ORIGIN)
    assert asked.waits(fix(60.5, (-9.0, 4.0)), state(60.5, (5.0, 0.0)), ORIGIN), "that is another place"
    assert not asked.waits(fix(61.0, (-4.0, 5.0)), state(61.0, (10.0, 0.0)), ORIGIN), "5 m on, as the filter"


@pytest.mark.parametrize(("known_m", "wrong"), [(4.0, 0.04), (10.0, 0.029)])
def test_what_hardly_moves_the_filter_or_is_sure_enough_does_not_wait(known_m: float, wrong: float) -> None:
    assert not SecondOpinion().waits(fix(60.0, (13.0, 0.0), wrong), state(60.0, sigma_m=known_m), ORIGIN)


def test_nothing_waits_before_the_filter_is_anywhere() -> None:
    assert not SecondOpinion().waits(fix(60.0, (13.0, 0.0)), None, ORIGIN)
    assert not SecondOpinion().waits(fix(60.0, (13.0, 0.0)), state(60.0), None)


def test_what_waited_is_forgotten() -> None:
    asked = SecondOpinion()
    assert asked.waits(fix(60.0, (13.0, 0.0)), state(60.0), ORIGIN)
    assert asked.waits(fix(70.5, (13.0, 0.0)), state(70.5), ORIGIN), "too long ago"
    asked.clear()
    assert asked.waits(fix(71.0, (13.0, 0.0)), state(71.0), ORIGIN), "a fix was taken in between"


def about(t_s: float, sigma_m: float, at_ne_m: Vec2 = (0.0, 0.0)) -> NavState:
    """As unsure to the north as to the east."""
    return replace(state(t_s, at_ne_m), cov_ne_m2=((sigma_m**2, 0.0), (0.0, sigma_m**2)))


def test_rare_fixes_confirm_each_other_where_the_filter_hardly_grew_and_chance_is_small() -> None:
    """After an operator's word the filter is 40 m wide, and odometry keeps it so: every doubtful fix waited for ever."""
    asked = SecondOpinion()
    assert asked.waits(fix(60.0, (30.0, 0.0)), about(60.0, 40.0), ORIGIN)
    assert asked.waits(fix(72.0, (20.0, 9.0)), about(72.0, 40.1), ORIGIN), "another place"
    assert not asked.waits(fix(84.0, (21.0, 10.0)), about(84.0, 40.2), ORIGIN)


@pytest.mark.parametrize(("before_m", "now_m"), [(40.0, 60.0), (10.0, 10.0)])
def test_but_not_where_it_grew_or_two_places_are_as_near_by_chance(before_m: float, now_m: float) -> None:
    asked = SecondOpinion()
    assert asked.waits(fix(60.0, (9.0, 0.0)), about(60.0, before_m), ORIGIN)
    assert asked.waits(fix(72.0, (9.0, 0.0)), about(72.0, now_m), ORIGIN)


def test_one_answer_does_not_confirm_itself() -> None:
    asked = SecondOpinion()
    assert asked.waits(fix(60.0, (13.0, 0.0)), state(60.0), ORIGIN)
    assert asked.waits(fix(60.0, (13.0, 0.0)), state(60.0), ORIGIN)


def seeing_again(world: type[World], off_ne_m: Any, every_s: float = 0.5) -> World:
    """Blind for half a minute after GNSS is lost; the k-th fix after that may be wrong with 4 % and is off by `off_ne_m(k)`."""

    class Doubtful(world):  # type: ignore[misc]
        n_doubtful = 0

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, found = self.answers[-1]
            if self.t < SEES_AGAIN_S or not isinstance(found, Fix):
                return
            north, east = off_ne_m(self.n_doubtful)
            self.n_doubtful += 1
            place = wgs84.geo_from_ned((north, east, 0.0), found.place)
            self.answers[-1] = (when, replace(found, place=place, probability_wrong=0.04))

    settings = CoreSettings(injection=InjectionSettings(switch_source=True), structure=False)
    blind = {"jammed": lambda t: t > JAMMED_S, "blind": lambda t: JAMMED_S - 1 < t < SEES_AGAIN_S}
    w = Doubtful(settings=settings, fix_period_s=every_s, **blind)
    w.start()
    return w


def test_a_lone_wrong_fix_is_never_taken(world: type[World]) -> None:
    w = seeing_again(world, lambda k: (WRONG_M, -WRONG_M) if k == 0 else (0.0, 0.0)).fly(60)
    assert len(w.notices("waits for a second one")) >= 2, "the wrong one, and the first that is right"
    before = [error for t, _, error in w.statuses if SEES_AGAIN_S - 1 < t < SEES_AGAIN_S]
    assert max(before) > 3.0, "the filter has drifted"
    after = [error for t, _, error in w.statuses if t > SEES_AGAIN_S + 2]
    assert max(after) < 5.0
    assert w.status_at(59)[0].mode is Mode.AIDING
    assert math.hypot(WRONG_M, WRONG_M) > 3 * max(after)


def test_two_that_agree_are_taken(world: type[World]) -> None:
    w = seeing_again(world, lambda k: (0.0, 0.0)).fly(60)
    assert len(w.notices("waits for a second one")) == 1
    assert max(error for t, _, error in w.statuses if t > SEES_AGAIN_S + 1.5) < 5.0


@pytest.mark.parametrize("every_s", [5.0, 7.0])
def test_where_frames_are_rare_none_waits(world: type[World], every_s: float) -> None:
    """It would wait for as long as the filter goes on blindly: a flight was 16 m off for a right fix that waited 7 s."""
    w = seeing_again(world, lambda k: (0.0, 0.0), every_s).fly(60)
    assert not w.notices("waits for a second one")
    seen_s = math.ceil(SEES_AGAIN_S / every_s) * every_s
    assert max(error for t, _, error in w.statuses if seen_s - 1 < t < seen_s) > 5.0, "the filter has drifted"
    assert max(error for t, _, error in w.statuses if seen_s + 0.5 < t < seen_s + 1.5) < 5.0


def test_a_first_frame_after_a_long_gap_is_not_rare(world: type[World]) -> None:
    w = seeing_again(world, lambda k: (0.0, 0.0))
    w.camera = lambda t: not JAMMED_S < t < SEES_AGAIN_S
    assert len(w.fly(60).notices("waits for a second one")) == 1
