"""A plane that sees nothing: what its pitot tube says of the air holds the velocity, as far as it was taught."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import GeoPoint, NavState

G, SPEED_MPS, WIND_NORTH_MPS, FALSE_MPS = 9.80665, 20.0, 5.0, 4.0
ORIGIN, LEG_S, BLIND_S = GeoPoint(59.3, 18.1, 40.0), 20, 30


def flown(courses: tuple[float, ...], *, taught: bool = True) -> tuple[Tracker, NavState, float]:
    """Legs of LEG_S beside GNSS, the last of them unheard by the tube; then straight on without it, while the autopilot's
    velocity is off by FALSE_MPS. How far the state is off at the end, metres."""
    tracker, rng = Tracker(NavigatorSettings()), np.random.default_rng(1)
    tracker.set_origin(ORIGIN)
    tracker.height_above_home_m = 100.0
    north = east = 0.0
    for k in range((len(courses) * LEG_S + BLIND_S) * 50):
        t_ns, leg = k * 20_000_000, k // (50 * LEG_S)
        blind, course = leg >= len(courses), courses[min(leg, len(courses) - 1)]
        v_north, v_east = SPEED_MPS * math.cos(course) + WIND_NORTH_MPS, SPEED_MPS * math.sin(course)
        north, east = north + 0.02 * v_north, east + 0.02 * v_east
        place = wgs84.geo_from_ned((north, east, -100.0), ORIGIN)
        if k % 5 == 0:
            drive, sigma_mps = (Drive.FED_BACK, 0.8) if blind else (Drive.AUTOPILOT, 0.3)
            tracker.drive(Velocity(t_ns, (v_north + FALSE_MPS * blind, v_east, 0.0), 140.0, sigma_mps, drive), t_ns, alone=blind)
        if k == 0:
            tracker.seed(0, place, 2.0)
        if not blind and k % 50 == 0:
            tracker.observe_gnss(t_ns, place, 1.0)
        if k % 10 == 0 and (blind or (taught and leg < len(courses) - 1)):
            noise = 0.2 * rng.standard_normal(2)
            tracker.on_airspeed(t_ns, (v_north - WIND_NORTH_MPS + noise[0], v_east + noise[1]))
        force = np.array((0.0, 0.0, -G)) + 0.3 * rng.standard_normal(3)
        tracker.on_force(t_ns, tuple(force.tolist()), quat_from_euler(0.0, 0.0, course))
    state = tracker.at((len(courses) * LEG_S + BLIND_S) * 1_000_000_000)
    assert state is not None
    return tracker, state, math.hypot(state.p_ned_m[0] - north, state.p_ned_m[1] - east)


def test_a_tube_that_was_taught_holds_the_velocity() -> None:
    tracker, state, off_m = flown((0.0, 1.6, 3.1, 0.0))
    assert tracker.belief is not None
    assert tracker.belief.drive is Drive.INERTIAL
    assert off_m < 0.3 * FALSE_MPS * BLIND_S
    assert off_m < 3 * math.sqrt(state.cov_ne_m2[0][0] + state.cov_ne_m2[1][1])


@pytest.mark.parametrize(("courses", "taught"), [((0.0, 0.0, math.pi), True), ((0.0, 0.0, 0.0), False)])
def test_a_tube_that_was_taught_on_another_course_alone_or_none_holds_nothing(
    courses: tuple[float, ...], *, taught: bool
) -> None:
    """The autopilot's own velocity carries it, and may be off."""
    tracker, _, off_m = flown(courses, taught=taught)
    assert tracker.belief is not None
    assert tracker.belief.drive is Drive.FED_BACK
    assert off_m == pytest.approx(FALSE_MPS * BLIND_S, rel=0.1)
