"""Whether the vehicle is too low to be localised: by the autopilot's height, unless fixes show that it is far off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.types import Fix, GeoPoint, LocaliseRequest, Mode

HOME = GeoPoint(48.0, 11.0, 500.0)
S = 1_000_000_000
STILL = (0.0, 0.0)


def climbing(tracker: Tracker, t_s: float, said_m: float) -> None:
    """The autopilot says so many metres above home."""
    t_ns = round(t_s * S)
    tracker.drive(Velocity(t_ns, (0.0, 0.0, -2.0), HOME.h_amsl_m + said_m, 0.3, Drive.AUTOPILOT), t_ns, alone=True)
    tracker.height.drive(t_ns, HOME.h_amsl_m + said_m, said_m)
    tracker.height_above_home_m = said_m


def fix_at(t_s: float, above_home_m: float) -> Fix:
    t_ns, place = round(t_s * S), replace(HOME, h_amsl_m=HOME.h_amsl_m + above_home_m)
    return Fix(t_ns, t_ns, 1, 1, "deep", place, (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 1e-4, 1.0)


@pytest.fixture
def tracker() -> Tracker:
    made = Tracker(NavigatorSettings())
    made.set_origin(HOME)
    climbing(made, 1.0, 0.1)
    assert made.seed(S, HOME, 2.0)
    return made


def test_without_fixes_the_autopilots_height_counts(tracker: Tracker) -> None:
    assert tracker.low
    tracker.height_above_home_m = 40.0
    assert not tracker.low
    tracker.height_above_home_m = None
    assert not tracker.low


def test_an_autopilot_that_stays_at_zero_while_fixes_see_it_climb_is_not_believed(tracker: Tracker) -> None:
    """ArduCopter without GNSS from boot says 0.1 m at 42 m above home: no picture was asked about for 5 s after the first fix."""
    tracker.height.taken(fix_at(1.0, 42.0), STILL)
    assert not tracker.low
    climbing(tracker, 2.5, 0.1)
    assert not tracker.low


def test_one_fix_alone_is_not_believed_for_long_and_many_are(tracker: Tracker) -> None:
    tracker.height.taken(fix_at(1.0, 42.0), STILL)
    climbing(tracker, 9.0, 0.1)
    assert tracker.low
    for k in range(20):
        climbing(tracker, 10.0 + k, 0.1)
        tracker.height.taken(fix_at(10.0 + k, 42.0), STILL)
    climbing(tracker, 33.0, 0.1)
    assert not tracker.low


@pytest.mark.parametrize("seen_m", [12.0, 3.0, -8.0])
def test_fixes_that_are_low_themselves_change_nothing(tracker: Tracker, seen_m: float) -> None:
    tracker.height.taken(fix_at(1.0, seen_m), STILL)
    assert tracker.low


def test_a_fix_a_little_above_the_autopilots_height_does_not_keep_a_landing_going(tracker: Tracker) -> None:
    climbing(tracker, 2.0, 14.0)
    tracker.height.taken(fix_at(2.0, 17.0), STILL)
    assert tracker.low


def over_the_valley(tracker: Tracker, t_s: float, said_m: float, above_ground_m: float | None) -> None:
    climbing(tracker, t_s, said_m)
    tracker.height.taken(replace(fix_at(t_s, said_m), above_ground_m=above_ground_m), STILL)


def test_a_vehicle_at_the_height_of_its_home_on_a_ridge_is_not_low_over_the_valley(tracker: Tracker) -> None:
    over_the_valley(tracker, 10.0, 20.0, 300.0)
    climbing(tracker, 20.0, 5.0)
    assert not tracker.low
    climbing(tracker, 39.0, 5.0)
    assert not tracker.low
    climbing(tracker, 41.0, 5.0)
    assert tracker.low, "no fix for long"


@pytest.mark.parametrize("above_ground_m", [None, 20.0, 60.0])
def test_a_landing_at_home_is_low_whatever_fixes_saw_on_the_way_down(tracker: Tracker, above_ground_m: float | None) -> None:
    """The ground that the last fix looked at may lie lower than home by 40 m."""
    over_the_valley(tracker, 10.0, 20.0, above_ground_m)
    climbing(tracker, 13.0, 14.0)
    assert tracker.low
    over_the_valley(tracker, 14.0, 12.0, 12.0)
    assert tracker.low


def test_over_the_valley_a_height_that_jumps_or_counts_from_another_zero_is_not_gone_by(tracker: Tracker) -> None:
    over_the_valley(tracker, 10.0, 20.0, 300.0)
    tracker.height.forget_heights()
    climbing(tracker, 20.0, 5.0)
    assert tracker.low


def test_who_flies_out_level_from_a_ridge_without_gnss_is_aided_all_the_way(world: type[Any]) -> None:
    """From 44 s on 5 m above home, 305 m above the valley."""

    @dataclass
    class Valley(world):  # type: ignore[misc]
        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, answer = self.answers.pop()
            self.answers.append((when, replace(answer, above_ground_m=300.0 + self.height_m(self.t))))

    w = Valley(jammed=lambda t: t > 15, height_m=lambda t: max(5.0, min(100.0, 100.0 - 4 * (t - 20))))
    w.start()
    w.fly(80.0)
    assert {s.mode for t, s, _ in w.statuses if t > 20} == {Mode.AIDING}
    assert max(off_m for t, _, off_m in w.statuses if t > 20) < 5.0
