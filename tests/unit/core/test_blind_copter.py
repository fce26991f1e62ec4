"""A copter that sees nothing for a minute: what its rotors feel of the air holds the velocity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import AIR, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Fix, FloatArray, GeoPoint, NavState, Quat, Vec3

G, SPEED, K1, K2 = 9.80665, 10.0, 0.25, 0.01
LEARNS_S, BLIND_S, LEG_S = 90, 60, 15
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
FALSE_TILT_RAD = math.radians(0.6)


def lean_rad(k1: float) -> float:
    """By which the thrust holds against the drag."""
    lean = 0.0
    for _ in range(20):
        u = SPEED * math.cos(lean)
        lean = math.asin((k1 + K2 * u) * u / G) if k1 else 0.0
    return lean


def at(t_s: float) -> tuple[Vec3, Vec3, float]:
    """Position and velocity NED about the origin (100 m up) and heading: a square of legs, then straight on."""
    position, heading, last = np.zeros(3), 0.0, LEARNS_S // LEG_S - 1
    for leg in range(min(last, int(t_s // LEG_S)) + 1):
        heading = leg % 4 * math.pi / 2
        along = SPEED * np.array([math.cos(heading), math.sin(heading), 0.0])
        position = position + along * (t_s - leg * LEG_S if leg == last else min(LEG_S, t_s - leg * LEG_S))
    north, east, _ = position.tolist()
    return (north, east, -100.0), tuple(along.tolist()), heading


def flown(k1: float, *, pitot: bool = False, sight: bool = True) -> tuple[Tracker, NavState]:
    """GNSS until LEARNS_S; then the autopilot's attitude is false by half a degree and its velocity by 3 m/s."""
    tracker, rng, lean = Tracker(NavigatorSettings()), np.random.default_rng(1), lean_rad(k1)
    tracker.set_origin(ORIGIN)
    tracker.height_above_home_m = 100.0
    for k in range((LEARNS_S + BLIND_S) * 50):
        t_ns, blind = k * 20_000_000, k >= LEARNS_S * 50
        position, (v_north, v_east, _), heading = at(t_ns * 1e-9)
        if k % 5 == 0:
            v_ned = (v_north + 3.0 * blind, v_east, 0.0)
            drive = Drive.FED_BACK if blind else Drive.AUTOPILOT
            tracker.drive(Velocity(t_ns, v_ned, 140.0, 0.8 if blind else 0.3, drive), t_ns, alone=blind)
        if k == 0:
            tracker.seed(0, wgs84.geo_from_ned(position, ORIGIN), 2.0)
        if pitot and k % 10 == 0:
            tracker.on_airspeed(t_ns, (v_north + 5.0, v_east))
        if not blind and k % 50 == 0:
            tracker.observe_gnss(t_ns, wgs84.geo_from_ned(position, ORIGIN), 1.0)
        if sight and LEARNS_S * 50 - 100 <= k < LEARNS_S * 50 and k % 25 == 0:
            tracker.observe(fix(t_ns, position))
        force = (-G * math.sin(lean), 0.0, -G * math.cos(lean)) + 0.3 * rng.standard_normal(3)
        q: Quat = quat_from_euler(0.0, -lean + FALSE_TILT_RAD * blind, heading)
        tracker.on_force(t_ns, tuple(force.tolist()), q)
    state = tracker.at((LEARNS_S + BLIND_S) * 1_000_000_000)
    assert state is not None
    return tracker, state


def fix(t_ns: int, position: Vec3) -> Fix:
    cov = ((1.0, 0.0), (0.0, 1.0))
    return Fix(t_ns, t_ns, 1, 1, "t", wgs84.geo_from_ned(position, ORIGIN), (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0)


def off_m(state: NavState) -> float:
    (north, east, _), _, _ = at(LEARNS_S + BLIND_S)
    return math.hypot(state.p_ned_m[0] - north, state.p_ned_m[1] - east)


@pytest.mark.parametrize(("pitot", "sight"), [(False, True), (True, True), (False, False)])
def test_drag_holds_the_velocity_for_a_minute(pitot: bool, sight: bool) -> None:
    tracker, state = flown(K1, pitot=pitot, sight=sight)
    assert tracker.belief is not None
    assert tracker.belief.drive is Drive.INERTIAL
    assert off_m(state) < 40.0
    assert off_m(state) < 3 * math.sqrt(state.cov_ne_m2[0][0] + state.cov_ne_m2[1][1])
    assert tracker.belief.P[AIR, AIR].trace() < 2 * 1.5**2


def test_without_drag_the_autopilots_velocity_carries_it_away() -> None:
    tracker, state = flown(0.0)
    assert tracker.belief is not None
    assert tracker.belief.drive is Drive.FED_BACK
    assert off_m(state) > 100.0


def with_rare_fixes(seed: int, gusts_mps: float = 0.0) -> FloatArray:
    """A fix in 2 s (0.7 m, 0.25 s late) once the receiver is gone: errors (n, 2) in metres and the covariances' (n, 2, 2)."""
    tracker, rng = Tracker(NavigatorSettings()), np.random.default_rng(seed)
    tracker.set_origin(ORIGIN)
    tracker.height_above_home_m = 100.0
    kept, gust, off, late = math.exp(-0.02 / 15), np.zeros(2), [], None
    for k in range((LEARNS_S + BLIND_S) * 50):
        t_ns, alone = k * 20_000_000, k >= LEARNS_S * 50
        position, v_ned, heading = at(t_ns * 1e-9)
        gust = kept * gust + gusts_mps * math.sqrt(1 - kept**2) * rng.standard_normal(2)
        if k % 5 == 0:
            drive = Drive.FED_BACK if alone else Drive.AUTOPILOT
            tracker.drive(Velocity(t_ns, v_ned, 140.0, 0.8 if alone else 0.3, drive), t_ns, alone=alone)
        if k == 0:
            tracker.seed(0, wgs84.geo_from_ned(position, ORIGIN), 2.0)
        if not alone and k % 50 == 0:
            tracker.observe_gnss(t_ns, wgs84.geo_from_ned(position, ORIGIN), 1.0)
        if late is not None and t_ns >= late.t_ns + 250_000_000:
            tracker.observe(late)
            late = None
        if k % (100 if alone else 25) == 0:
            north, east = 0.7 * rng.standard_normal(2)
            seen = fix(t_ns, (position[0] + north, position[1] + east, position[2]))
            late = replace(seen, cov_ne_m2=((0.49, 0.0), (0.0, 0.49)))
        ahead, aside = math.cos(heading), math.sin(heading)
        u = np.array([[ahead, aside], [-aside, ahead]]) @ (np.array(v_ned[:2]) - gust)
        drag = -(K1 + K2 * abs(u)) * u
        lean = lean_rad(K1)
        force = np.array([drag[0], drag[1], -G * math.cos(lean)]) + 0.3 * rng.standard_normal(3)
        tilted = quat_from_euler(0.0, -lean + FALSE_TILT_RAD * alone, heading)
        tracker.on_force(t_ns, tuple(force.tolist()), tilted)
        if alone and k % 5 == 0 and k >= (LEARNS_S + 10) * 50:
            state = tracker.at(t_ns)
            assert state is not None
            off.append((*(np.array(state.p_ned_m[:2]) - position[:2]), *state.cov_ne_m2[0], *state.cov_ne_m2[1]))
    return np.array(off)


@pytest.mark.parametrize(("seed", "gusts_mps", "p95_m"), [(2, 0.0, 2.5), (1, 1.0, 3.2)])
def test_between_rare_fixes_drag_holds_the_velocity(seed: int, gusts_mps: float, p95_m: float) -> None:
    off = with_rare_fixes(seed, gusts_mps)
    assert np.percentile(np.hypot(*off[:, :2].T), 95) < p95_m
    nees = [d @ np.linalg.solve(P.reshape(2, 2), d) for d, P in zip(off[:, :2], off[:, 2:], strict=True)]
    assert 0.5 < np.mean(nees) < 2.6
    assert np.percentile(nees, 95) < 7.4
