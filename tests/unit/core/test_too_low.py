"""Whether the vehicle is too low to be localised: by the autopilot's height, unless fixes show that it is far off."""

from __future__ import annotations

from dataclasses import replace

import pytest

from visloc_companion.core.driving import Velocity
from visloc_companion.core.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.types import Fix, GeoPoint

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
