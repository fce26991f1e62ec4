"""A camera that looks beside where it should: fixes are off in the vehicle's own axes, and so are motions in which it turns."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Attitude, Command, Event, Fix, FrameRef, Injection, LocaliseRequest, Notice, Odometry

COV = ((0.01, 0.0), (0.0, 0.01))
HEIGHT_M, SPEED_MPS, TURN_S = 100.0, 10.0, 6.0
BOOT_BEFORE_NS = -995_000_000_000
"""The shell's clock less the autopilot's, as conftest.py has them: frames bear the autopilot's time."""


def told(w: Any) -> list[str]:
    return [c.text for _, c in w.commands if isinstance(c, Notice) and c.to_operator]


def aims(w: Any) -> list[str]:
    return [text for text in told(w) if "visloc: fixes" in text]


def suspected_s(w: Any) -> float:
    return next((t for t, c in w.commands if isinstance(c, Notice) and "GNSS not trusted" in c.text), math.inf)


def beyond(w: Any, since_s: float) -> list[float]:
    return [t for t, s, off_m in w.statuses if t > since_s and s.injected and off_m >= s.protection_level_m]


@pytest.fixture
def flight(world: Any) -> type[Any]:
    """The nose ahead on a straight course, which bends by 90 degrees within TURN_S at each of `turns_s`; `aim`: the share of the
    height by which fixes lie beside the vehicle, forward + i right."""

    @dataclass
    class Flight(world):  # type: ignore[misc]
        aim: complex = 0j
        turns_s: tuple[float, ...] = ()
        fix_sigma_m: float = 0.6

        def heading_rad(self, t_s: float) -> float:
            return sum(math.pi / 2 * min(1.0, max(0.0, (t_s - turn_s) / TURN_S)) for turn_s in self.turns_s) + 0.4

        def velocity(self, t_s: float) -> tuple[float, float]:
            v = cmath.rect(SPEED_MPS, self.heading_rad(t_s))
            return v.real, v.imag

        def send(self, event: Event) -> list[Command]:
            if isinstance(event, Attitude):
                event = replace(event, q_ned_frd=se3.quat_from_euler(0.0, 0.0, self.heading_rad(self.t)))
            if isinstance(event, FrameRef):
                event = replace(event, t_boot_ns=event.t_ns - BOOT_BEFORE_NS)
            return super().send(event)  # type: ignore[no-any-return]

        def off_m(self, t_s: float) -> complex:
            return self.aim * HEIGHT_M * cmath.rect(1.0, self.heading_rad(t_s))

        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, fix = self.answers.pop()
            t1_s, t0_s = fix.t_ns * 1e-9, fix.t_ns * 1e-9 - self.fix_period_s
            swung = self.off_m(t1_s) - self.off_m(t0_s)
            north, east = self.velocity((t0_s + t1_s) / 2)
            moved = (north * self.fix_period_s + swung.real, east * self.fix_period_s + swung.imag, 0.0)
            motion = Odometry(0, round(t0_s * 1e9), fix.t_ns, moved, COV, 0.01, 0.02)
            if isinstance(fix, Fix):
                off = self.off_m(t1_s)
                fix = replace(fix, place=wgs84.geo_from_ned((off.real, off.imag, 0.0), fix.place))
            self.answers.append((when, replace(fix, motion=motion)))

    return Flight


def flown(flight: Any, until_s: float, **how: Any) -> Any:
    w = flight(**how)
    w.start()
    return w.fly(until_s)


@pytest.mark.parametrize("aim", [0.058j, -0.058, 0.04 - 0.03j])
def test_a_camera_that_looks_elsewhere_is_in_the_level_on_one_course_and_in_the_turn_after_it(flight: Any, aim: complex) -> None:
    w = flown(flight, 90.0, aim=aim, turns_s=(50.0,), jammed=lambda t: t > 28)
    assert any(isinstance(c, Injection) for _, c in w.commands)
    assert beyond(w, 28.0) == []
    assert not any("cx/cy_px" in text for text in aims(w)), "one heading before the jam does not tell"


@pytest.mark.parametrize("aim", [0.058j, -0.058])
def test_a_good_gnss_stays_trusted_in_a_turn_after_a_minute_and_what_it_shows_is_taken_off(flight: Any, aim: complex) -> None:
    w = flown(flight, 130.0, aim=aim, turns_s=(60.0, 110.0), jammed=lambda t: t > 90)
    assert suspected_s(w) == math.inf
    assert aims(w)[-1].endswith("cx/cy_px, mount, lever?")
    assert beyond(w, 90.0) == []
    sent_m = [off_m for t, s, off_m in w.statuses if s.injected and t > 92]
    assert sent_m
    assert max(sent_m) < 3.0
    assert w.statuses[-1][1].protection_level_m > 5.8, "whose fault it is, nobody knows"


def test_a_right_camera_is_as_ever(flight: Any) -> None:
    """The same bytes: nothing learns of it."""
    plain = flight(turns_s=(20.0, 40.0), jammed=lambda t: t > 60)
    plain.navigator._onboard._aim.on_fix = lambda *_, **__: []
    w = flight(turns_s=(20.0, 40.0), jammed=lambda t: t > 60)
    for each in (plain, w):
        each.start()
        each.fly(75.0)
    assert aims(w) == []
    assert w.statuses == plain.statuses
    assert [c for _, c in w.commands if isinstance(c, Injection)] == [c for _, c in plain.commands if isinstance(c, Injection)]


def dragged(begins_s: float, mps: complex) -> Callable[[float], tuple[float, float]]:
    def pull_m(t_s: float) -> tuple[float, float]:
        pulled = max(0.0, t_s - begins_s) * mps * cmath.rect(1.0, 0.4)
        return pulled.real, pulled.imag

    return pull_m


@pytest.mark.parametrize("mps", [0.5, 1j, -2.0])
@pytest.mark.parametrize("begins_s", [12.0, 40.0])
def test_a_drag_beside_a_right_camera_is_found_as_soon_as_ever(flight: Any, begins_s: float, mps: complex) -> None:
    how = {"turns_s": (20.0,), "pull_m": dragged(begins_s, mps), "seed": 5}
    plain, w = flight(**how), flight(**how)
    plain.navigator._onboard._aim.on_fix = lambda *_, **__: []
    for each in (plain, w):
        each.start()
        each.fly(begins_s + 20.0)
    assert suspected_s(w) == suspected_s(plain) < math.inf
    assert aims(w) == []


def test_a_drag_beside_a_camera_that_looks_elsewhere_is_found_a_few_seconds_later(flight: Any) -> None:
    w = flown(flight, 65.0, aim=0.058j, turns_s=(20.0,), pull_m=dragged(40.0, 1.0), seed=5)
    assert 40.0 < suspected_s(w) < 50.0


def test_a_gnss_that_goes_round_with_the_nose_leads_no_further_than_a_tenth_of_the_height(flight: Any) -> None:
    """Who knows the heading and pulls from the start on is believed up to there, within the level; who begins later is found."""

    def round_m(w: Any, begins_s: float, share: float) -> Callable[[float], tuple[float, float]]:
        def pull_m(t_s: float) -> tuple[float, float]:
            pulled_m = min(1.0, max(0.0, (t_s - begins_s) / 10)) * share * HEIGHT_M
            pulled = 1j * pulled_m * cmath.rect(1.0, w.heading_rad(t_s))
            return pulled.real, pulled.imag

        return pull_m

    for begins_s, share in ((-10.0, 0.08), (-10.0, 0.2), (30.0, 0.08)):
        w = flight(turns_s=(20.0, 40.0), jammed=lambda t: t > 70)
        w.pull_m = round_m(w, begins_s, share)
        w.start()
        w.fly(85.0)
        led_m = max(off_m for t, s, off_m in w.statuses if s.injected)
        assert led_m < 0.1 * HEIGHT_M
        assert beyond(w, 0.0) == []
        if begins_s > 0:
            assert 30.0 < suspected_s(w) < 45.0
            assert led_m < 3.0
