"""Which time a frame is given, and what is said about it."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera_time import SURE_S, UNKNOWN_S, CameraTime
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Command, Fix, FrameRef, GeoPoint, Notice, Quat, Turn

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
COV = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
S = 1_000_000_000
BOOT_NS = 3 * S
FIX = Fix(0, 0, 1, 1, "image", GeoPoint(48.0, 11.0, 500.0), LEVEL, ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.01, 1e-4, 1.0)


class Vehicle:
    """Rocks, and sends frames that arrive late."""

    def __init__(self, late_s: float, jitter_s: float = 0.0, *, own_clock: bool = False, rocking_rad: float = 0.05) -> None:
        self.clock, self.attitude = ClockOffset(), AttitudeBuffer()
        self.camera = CameraTime(self.clock, self.attitude)
        self.late_s, self.jitter_s, self.own_clock, self.rocking_rad = late_s, jitter_s, own_clock, rocking_rad
        self.said: list[Command] = []
        self.errors_s: list[float] = []

    def attitude_at(self, t_s: float) -> Quat:
        a = self.rocking_rad
        return se3.quat_from_euler(a * math.sin(2.3 * t_s), a * math.sin(1.6 * t_s + 1), 0.3 * math.sin(0.4 * t_s))

    def fly(self, seconds: float) -> None:
        """The attitude at 50 Hz, a frame each 200 ms, its answer 0.7 s later."""
        rng = Random(5)
        arrivals = [(0.2 * k + self.late_s + rng.uniform(-1, 1) * self.jitter_s, k) for k in range(1, round(5 * seconds))]
        given: dict[int, FrameRef] = {}
        sent = 0
        for t_s, k in arrivals:
            while sent * 0.02 < t_s:
                now_ns = 10 * S + round(sent * 0.02 * S)
                self.clock.on_arrival(now_ns, now_ns - BOOT_NS)
                self.attitude.add(now_ns - BOOT_NS, self.attitude_at(sent * 0.02), (0.0, 0.0, 0.0))
                sent += 1
            t_ns = 10 * S + round(t_s * S)
            own_ns = 10 * S + round((0.2 * k + self.late_s) * S) - BOOT_NS if self.own_clock else None
            frame = FrameRef(t_ns, t_ns, k, 0, 640, 480, 3, own_ns)
            given[k] = self.camera.on_frame(frame)
            self.errors_s.append((given[k].t_ns - 10 * S) / S - 0.2 * k)
            self.said += self.camera.on_turn(self.turn(k - 4, given), LEVEL)

    def turn(self, k: int, given: dict[int, FrameRef]) -> Turn | None:
        if k - 1 not in given:
            return None
        a, b = self.attitude_at(0.2 * (k - 1)), self.attitude_at(0.2 * k)
        return Turn(given[k - 1].t_ns, given[k].t_ns, se3.quat_multiply(se3.quat_inverse(a), b), COV)

    @property
    def told(self) -> list[str]:
        return [n.text for n in self.said if isinstance(n, Notice) and n.to_operator]


@pytest.mark.parametrize("late_s", [0.05, 0.3])
def test_frames_that_arrive_late_get_the_time_when_they_were_taken(late_s: float) -> None:
    vehicle = Vehicle(late_s)
    vehicle.fly(40)
    assert np.abs(vehicle.errors_s[-50:]).max() < 0.01
    assert vehicle.camera.sigma_s <= SURE_S
    assert vehicle.told == []
    assert not vehicle.camera.wrong
    assert [n.text for n in vehicle.said if isinstance(n, Notice)] == ["camera's delay found"]


def test_jitter_goes_too() -> None:
    vehicle = Vehicle(0.3, 0.09)
    vehicle.fly(120)
    last = np.array(vehicle.errors_s[-150:])
    assert float(np.sqrt((last**2).mean())) < 0.02
    assert float(np.sqrt(((last / vehicle.camera.sigma_s) ** 2).mean())) < 3


def test_a_flight_that_never_turns_leaves_frames_as_they_are_and_says_so() -> None:
    vehicle = Vehicle(0.3, rocking_rad=0.0)
    vehicle.attitude_at = lambda t_s: LEVEL  # type: ignore[method-assign]
    vehicle.fly(60)
    assert vehicle.told == []
    assert vehicle.errors_s[-1] == pytest.approx(0.3, abs=1e-6)
    assert vehicle.camera.sigma_s >= UNKNOWN_S
    assert vehicle.camera.estimate.sigma_s > 0.1
    (nn, ne), (_, ee) = vehicle.camera.stated(FIX, (20.0, 0.0, 0.0)).cov_ne_m2
    assert (nn, ne, ee) == pytest.approx((1 + (20 * UNKNOWN_S) ** 2, 0.0, 1.0), abs=1e-3)


def test_who_never_turns_is_asked_to_once() -> None:
    vehicle = Vehicle(0.3)
    vehicle.attitude_at = lambda t_s: LEVEL  # type: ignore[method-assign]
    vehicle.fly(200)
    assert vehicle.told == ["visloc: camera delay unknown, fly some turns"]


def test_stamps_of_the_cameras_own_stay_and_wrong_ones_are_told_once() -> None:
    right, wrong = Vehicle(0.0, own_clock=True), Vehicle(0.12, own_clock=True)
    for vehicle in (right, wrong):
        vehicle.fly(60)
        assert vehicle.errors_s == pytest.approx([vehicle.late_s] * len(vehicle.errors_s))
    assert right.told == []
    assert wrong.told == ["visloc: camera frames 120 ms too late"]
    assert right.camera.stated(FIX, (20.0, 0.0, 0.0)) is FIX
    (nn, ne), (_, ee) = wrong.camera.stated(FIX, (20.0, 0.0, 0.0)).cov_ne_m2
    assert (nn, ne, ee) == pytest.approx((1 + (20 * 0.12) ** 2, 0.0, 1.0), rel=0.1)


def test_stamps_that_are_no_arrivals_stay_too() -> None:
    camera = CameraTime(ClockOffset(), AttitudeBuffer())
    for k in range(60):
        t_ns = 10 * S + k * 200_000_000
        frame = FrameRef(t_ns + 50_000_000 + 1000 * (k % 7), t_ns, k, 0, 640, 480, 3)
        assert camera.on_frame(frame) is frame
    assert camera.sigma_s == 0.0


@pytest.mark.parametrize("late_s", [0.55, 1.0, 2.2])
def test_an_offset_that_is_too_large_is_told_and_claimed_but_not_used(late_s: float) -> None:
    vehicle = Vehicle(late_s)
    vehicle.fly(60)
    (told,) = vehicle.told
    assert told.startswith("visloc: camera frames ")
    assert told.endswith(" ms too late")
    assert float(told.split()[3]) == pytest.approx(1000 * late_s, abs=15)
    assert vehicle.camera.wrong
    assert vehicle.errors_s[-1] == pytest.approx(late_s, abs=1e-6)
    (nn, _), (_, ee) = vehicle.camera.stated(FIX, (20.0, 0.0, 0.0)).cov_ne_m2
    assert (nn, ee) == pytest.approx((1 + (20 * late_s) ** 2, 1.0), rel=0.1)


def test_turns_between_frames_that_nobody_knows_are_left_out() -> None:
    vehicle = Vehicle(0.1)
    vehicle.fly(2)
    before = vehicle.camera.estimate
    turn = Turn(1, 2, LEVEL, COV)
    assert vehicle.camera.on_turn(turn, LEVEL) == []
    assert vehicle.camera.estimate == before
    assert vehicle.camera.on_turn(None, LEVEL) == []


def test_the_covariance_grows_along_the_track_only() -> None:
    vehicle = Vehicle(0.1)
    vehicle.fly(2)
    stated = vehicle.camera.stated(replace(FIX, cov_ne_m2=((4.0, 1.0), (1.0, 4.0))), (10.0, 10.0, 1.0))
    extra = np.array(stated.cov_ne_m2) - np.array(((4.0, 1.0), (1.0, 4.0)))
    assert extra == pytest.approx(np.full((2, 2), (10 * UNKNOWN_S) ** 2), rel=0.01)
