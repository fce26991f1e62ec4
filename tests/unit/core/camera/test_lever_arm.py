"""The camera is not where the vehicle's IMU is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.lever_arm import LeverArm
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, GeoPoint, Injection, LocaliseRequest, NoFix, Odometry, OpenPlace, TimesyncSample

World = Any
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
LEVER = (2.0, -0.5, 0.3)
MOUNT = se3.quat_from_euler(0.0, 0.2, math.radians(90.0))
TURNED = se3.quat_from_euler(0.1, -0.05, math.radians(90.0))
S = 1_000_000_000


def arm(lever: tuple[float, float, float] = LEVER) -> LeverArm:
    """Boot clock and shell clock are one; the vehicle turns from north to east within a second."""
    clock, attitude = ClockOffset(), AttitudeBuffer()
    clock.on_exchange(TimesyncSample(2 * S, 2 * S, 2 * S))
    for k in range(21):
        attitude.add(S + k * S // 20, se3.quat_from_euler(0.0, 0.0, math.radians(4.5 * k)), (0.0, 0.0, 1.5))
    return LeverArm(lever, clock, attitude)


def fix(place: GeoPoint, motion: Odometry | None = None) -> Fix:
    q = se3.quat_multiply(TURNED, MOUNT)
    return Fix(0, S, 1, 1, "test", place, q, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 0.0, 5.0, motion=motion)


def test_there_and_back_is_the_same_place() -> None:
    lever = arm()
    camera = lever.camera_ned_m((10.0, 20.0, -100.0), TURNED)
    assert math.dist(camera, (10.0, 20.0, -100.0)) == pytest.approx(math.hypot(*LEVER))
    assert camera[1] - 20.0 == pytest.approx(2.0, abs=0.05)  # heading east, two metres ahead
    back = lever.of_vehicle(fix(wgs84.geo_from_ned(camera, ORIGIN)), MOUNT)
    assert isinstance(back, Fix)
    assert wgs84.ned_from_geo(back.place, ORIGIN) == pytest.approx((10.0, 20.0, -100.0), abs=1e-4)


def test_a_turn_on_the_spot_is_no_motion() -> None:
    lever = arm((2.0, 0.0, 0.0))
    moved = Odometry(0, S, 2 * S, (-2.0, 2.0, 0.0), ((0.1, 0.0), (0.0, 0.1)))
    answer = lever.of_vehicle(NoFix(0, S, 1, 1, "test", _reason(), 1.0, motion=moved), MOUNT)
    assert answer.motion is not None
    assert answer.motion.displacement_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    unknown = replace(moved, t_from_ns=50 * S, t_to_ns=51 * S)
    assert lever.of_vehicle(fix(ORIGIN, unknown), MOUNT).motion == unknown


def test_open_places_are_the_vehicles_too() -> None:
    lever, heading_east_ns = arm((2.0, 0.0, 0.0)), 2 * S
    seen = OpenPlace(ORIGIN, ((1.0, 0.0), (0.0, 1.0)), -0.7)
    none = NoFix(0, heading_east_ns, 1, 1, "test", _reason(), 1.0, open_places=(seen,), footprint_m=60.0)
    (place,) = lever.of_vehicle(none, MOUNT).open_places
    assert wgs84.ned_from_geo(place.place, ORIGIN) == pytest.approx((0.0, -2.0, 0.0), abs=1e-3)
    assert (place.cov_ne_m2, place.log_evidence) == (seen.cov_ne_m2, seen.log_evidence)
    assert lever.of_vehicle(replace(none, t_ns=99 * S), MOUNT).open_places == ()


def test_a_fix_through_a_longer_lens_is_the_vehicles_too() -> None:
    lever = arm()
    camera = wgs84.geo_from_ned(lever.camera_ned_m((10.0, 20.0, -100.0), TURNED), ORIGIN)
    none = NoFix(0, S, 1, 1, "test", _reason(), 1.0, zoomed=fix(camera))
    found = lever.of_vehicle(none, MOUNT)
    assert isinstance(found, NoFix)
    assert found.zoomed == lever.of_vehicle(fix(camera), MOUNT)
    assert found.zoomed is not None
    assert wgs84.ned_from_geo(found.zoomed.place, ORIGIN) == pytest.approx((10.0, 20.0, -100.0), abs=1e-4)


def test_without_a_lever_nothing_is_touched() -> None:
    lever, answer = arm((0.0, 0.0, 0.0)), fix(ORIGIN)
    assert lever.of_vehicle(answer, MOUNT) is answer
    assert lever.camera_ned_m((1.0, 2.0, 3.0), TURNED) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(("stated_m", "at_least_m", "at_most_m"), [(6.0, 0.0, 2.0), (0.0, 4.5, 8.0)])
def test_a_camera_six_metres_ahead_moves_what_is_injected_unless_it_is_stated(
    world: type[World], stated_m: float, at_least_m: float, at_most_m: float
) -> None:
    class Ahead(world):  # type: ignore[misc]
        def _localise(self, request: LocaliseRequest) -> None:
            super()._localise(request)
            when, answer = self.answers[-1]
            self.answers[-1] = (when, replace(answer, place=wgs84.geo_from_ned((6.0, 0.0, 0.0), answer.place)))

    settings = CoreSettings(injection=InjectionSettings(switch_source=True), lever_frd_m=(stated_m, 0.0, 0.0))
    w = Ahead(settings=settings, jammed=lambda t: t > 20)  # the vehicle of this world points north
    w.start()
    w.fly(60)
    assert w.first(Injection) < 30
    late = [error for t, _, error in w.statuses if t > 45]
    assert at_least_m < sum(late) / len(late) < at_most_m
    asked = [wgs84.ned_from_geo(r.prior.place, ORIGIN)[0] - float(w_n) for w_n, r in _north_when_asked(w)]
    assert sum(asked[-20:]) / 20 == pytest.approx(6.0, abs=1.5)


def _north_when_asked(w: World) -> list[tuple[float, LocaliseRequest]]:
    """The vehicle's true place north when each late frame was asked about."""
    track, north, t = [], 0.0, 0.0
    for _, request, _ in [item for item in w.requests if item[0] > 45]:
        while t + 0.05 <= request.frame.t_ns * 1e-9 + 1e-9:
            north += (w.velocity(t)[0] + w.velocity(t + 0.05)[0]) / 2 * 0.05
            t += 0.05
        track.append((north, request))
    return track


def _reason() -> Any:
    from visloc_companion.errors import Reason

    return Reason.NO_MATCH


def test_an_aim_goes_round_with_the_heading_and_stays_level() -> None:
    """It is beside the lever, of fixes and priors alike; a motion in which the vehicle turned from north to east has both."""
    aimed, place = arm(), GeoPoint(59.3, 18.1, 140.0)
    aimed.aim_m = 6j
    q = se3.quat_multiply(TURNED, MOUNT)
    (north, east, down) = (
        a - b
        for a, b in zip(
            wgs84.ned_from_geo(aimed.place_of_vehicle(place, q, MOUNT), place),
            wgs84.ned_from_geo(arm().place_of_vehicle(place, q, MOUNT), place),
            strict=True,
        )
    )
    assert (north, east, down) == pytest.approx((6.0, 0.0, 0.0), abs=0.05), "6 m right of east is south: back is north"
    there = aimed.camera_ned_m((0.0, 0.0, 0.0), TURNED)
    assert [a - b for a, b in zip(there, arm().camera_ned_m((0.0, 0.0, 0.0), TURNED), strict=True)] == pytest.approx(
        (-6.0, 0.0, 0.0), abs=0.05
    )
    motion = Odometry(0, S, 2 * S, (0.0, 0.0, 0.0), ((0.01, 0.0), (0.0, 0.01)))
    seen = [one.of_vehicle(fix(place, motion), MOUNT).motion for one in (aimed, arm())]
    assert seen[0] is not None
    assert seen[1] is not None
    moved = [a - b for a, b in zip(seen[0].displacement_ned_m, seen[1].displacement_ned_m, strict=True)]
    assert moved == pytest.approx((6.0, 6.0, 0.0), abs=0.05)
    assert seen[0].cov_ne_m2 == seen[1].cov_ne_m2 == motion.cov_ne_m2


def test_a_doubted_aim_makes_turning_motions_uncertain_and_no_other() -> None:
    doubted, place = arm((0.0, 0.0, 0.0)), GeoPoint(59.3, 18.1, 140.0)
    doubted.doubted_m = 5.0
    for t_to_ns, more_m2 in ((2 * S, 200.0), (S, 0.0)):
        motion = Odometry(0, S, t_to_ns, (3.0, 0.0, 0.0), ((0.01, 0.0), (0.0, 0.01)))
        seen = doubted.of_vehicle(fix(place, motion), MOUNT).motion
        assert seen is not None
        assert seen.displacement_ned_m == motion.displacement_ned_m
        assert seen.cov_ne_m2[0][0] == pytest.approx(0.01 + more_m2, rel=0.01)
