"""Which time a frame is given, and what is said about it."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random

import numpy as np
import pytest

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.camera_time import LARGEST_S, SURE_S, UNKNOWN_S, CameraTime
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
        self.later_from_s, self.later_s, self.latency_s = math.inf, 0.0, 0.0
        self.said: list[Command] = []
        self.errors_s: list[float] = []
        self.claimed_s: list[float] = []
        self.given_ns: list[int] = []
        self.boot_errors_s: list[float] = []

    def attitude_at(self, t_s: float) -> Quat:
        a = self.rocking_rad
        return se3.quat_from_euler(a * math.sin(2.3 * t_s), a * math.sin(1.6 * t_s + 1), 0.3 * math.sin(0.4 * t_s))

    def reported_at(self, t_s: float) -> Quat:
        return self.attitude_at(t_s)

    def late_at(self, t_s: float) -> float:
        """Of a frame that was taken then."""
        return self.late_s + (self.later_s if t_s >= self.later_from_s else 0.0)

    def fly(self, seconds: float) -> None:
        """The attitude at 50 Hz, a frame each 200 ms, its answer 0.7 s later."""
        rng = Random(5)
        taken = range(1, round(5 * seconds))
        arrivals = sorted((0.2 * k + self.late_at(0.2 * k) + rng.uniform(-1, 1) * self.jitter_s, k) for k in taken)
        given: dict[int, FrameRef] = {}
        sent = 0
        for t_s, k in arrivals:
            while sent * 0.02 < t_s:
                now_ns = 10 * S + round(sent * 0.02 * S)
                self.clock.on_arrival(now_ns, now_ns - BOOT_NS)
                self.attitude.add(now_ns - BOOT_NS, self.reported_at(sent * 0.02), (0.0, 0.0, 0.0))
                sent += 1
            t_ns = 10 * S + round(t_s * S)
            own_ns = 10 * S + round((0.2 * k + self.late_at(0.2 * k)) * S) - BOOT_NS if self.own_clock else None
            frame = FrameRef(t_ns, t_ns - round(self.latency_s * S), k, 0, 640, 480, 3, own_ns)
            given[k] = self.camera.on_frame(frame)
            self.errors_s.append((given[k].t_ns - 10 * S) / S - 0.2 * k)
            self.claimed_s.append(self.camera.sigma_s)
            self.given_ns.append(given[k].t_ns)
            boot_ns = given[k].t_boot_ns
            if boot_ns is not None:
                self.boot_errors_s.append((boot_ns + BOOT_NS - 10 * S) / S - 0.2 * k)
            self.said += self.camera.on_turn(self.turn(k - 4, given), LEVEL)

    def turn(self, k: int, given: dict[int, FrameRef]) -> Turn | None:
        if k - 1 not in given or k not in given:
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


def test_stamps_of_the_cameras_own_stay_while_they_are_right() -> None:
    vehicle = Vehicle(0.0, own_clock=True)
    vehicle.fly(60)
    assert vehicle.errors_s == pytest.approx([0.0] * len(vehicle.errors_s))
    assert vehicle.told == []
    assert vehicle.camera.stated(FIX, (20.0, 0.0, 0.0)) is FIX


@pytest.mark.parametrize(("late_s", "said"), [(0.12, "120 ms late"), (1.5, "1500 ms late"), (-0.4, "400 ms early")])
def test_stamps_of_its_own_that_are_wrong_are_corrected_and_told_once(late_s: float, said: str) -> None:
    vehicle = Vehicle(late_s, own_clock=True)
    vehicle.fly(60)
    assert vehicle.told == [f"visloc: frame stamps {said}, corrected"]
    assert len(vehicle.told[0]) <= 50
    assert vehicle.errors_s[5] == pytest.approx(late_s)
    assert np.abs(vehicle.errors_s[-50:]).max() < 0.01
    assert vehicle.boot_errors_s == pytest.approx(vehicle.errors_s, abs=1e-6)  # its attitude is that of the same moment
    (nn, ne), (_, ee) = vehicle.camera.stated(FIX, (20.0, 0.0, 0.0)).cov_ne_m2
    assert nn > 1
    assert (nn, ne, ee) == pytest.approx((1, 0.0, 1.0), abs=(20 * SURE_S) ** 2)


def test_they_are_not_corrected_for_what_a_few_turns_say() -> None:
    vehicle = Vehicle(0.0, own_clock=True)
    turn, right = vehicle.turn, vehicle.attitude_at

    def late_at_first(k: int, given: dict[int, FrameRef]) -> Turn | None:
        vehicle.attitude_at = (lambda t_s: right(t_s - 0.1)) if k < 20 else right  # type: ignore[method-assign]
        seen = turn(k, given)
        vehicle.attitude_at = right  # type: ignore[method-assign]
        return seen

    vehicle.turn = late_at_first  # type: ignore[method-assign]
    vehicle.fly(60)
    assert vehicle.told == []
    assert vehicle.camera.estimate.offset_s == pytest.approx(0.0, abs=0.005)


def test_stamps_that_are_no_arrivals_stay_too() -> None:
    camera = CameraTime(ClockOffset(), AttitudeBuffer())
    for k in range(60):
        t_ns = 10 * S + k * 200_000_000
        frame = FrameRef(t_ns + 50_000_000 + 1000 * (k % 7), t_ns, k, 0, 640, 480, 3)
        assert camera.on_frame(frame) is frame
    assert camera.sigma_s == 0.0


@pytest.mark.parametrize(("late_s", "latency_s"), [(0.55, 0.0), (1.0, 0.3), (2.2, 0.0)])
def test_frames_out_of_a_buffer_are_corrected_and_the_field_is_told(late_s: float, latency_s: float) -> None:
    vehicle = Vehicle(late_s)
    vehicle.latency_s = latency_s
    vehicle.fly(60)
    assert vehicle.told == [f"visloc: frames late, corrected: latency_s = {late_s:.2f}"]
    assert len(vehicle.told[0]) <= 50
    assert vehicle.camera.wrong
    assert vehicle.errors_s[5] == pytest.approx(late_s - latency_s, abs=1e-6)
    assert np.abs(vehicle.errors_s[-50:]).max() < 0.01
    (nn, _), (_, ee) = vehicle.camera.stated(FIX, (20.0, 0.0, 0.0)).cov_ne_m2
    most_s = 0.2 if late_s - latency_s > LARGEST_S else 0.01
    assert (nn, ee) == pytest.approx((1 + (20 * most_s) ** 2, 1.0), rel=0.1)


@pytest.mark.parametrize("own_clock", [False, True])
@pytest.mark.parametrize(("late_s", "later_s"), [(1.0, -0.7), (0.15, 0.5), (0.3, 1.5)])
def test_a_delay_that_jumps_is_claimed_at_once_and_found_anew(own_clock: bool, late_s: float, later_s: float) -> None:
    vehicle = Vehicle(late_s, own_clock=own_clock)
    vehicle.later_from_s, vehicle.later_s = 40.0, later_s
    vehicle.fly(80)
    jumped = next(k for k, error_s in enumerate(vehicle.errors_s) if k > 100 and abs(error_s) > 0.2)
    assert min(vehicle.claimed_s[jumped + 1 : jumped + 10]) >= 0.95 * late_s
    assert np.abs(vehicle.errors_s[-40:]).max() < 0.015
    assert vehicle.claimed_s[-1] < 0.25
    known = own_clock or late_s > LARGEST_S
    assert len(vehicle.told) == known + 1


def test_whoever_flies_straight_after_a_jump_has_it_in_the_claim_for_good() -> None:
    vehicle = Vehicle(1.0)
    vehicle.later_from_s, vehicle.later_s = 30.0, -0.7
    rocking_at = vehicle.attitude_at
    vehicle.attitude_at = lambda t_s: rocking_at(min(t_s, 28.0))  # type: ignore[method-assign]
    vehicle.fly(90)
    assert vehicle.errors_s[-1] == pytest.approx(-0.7, abs=0.02)
    assert vehicle.camera.sigma_s >= 0.99


def test_a_heading_that_is_wrong_and_drifts_is_no_delay() -> None:
    for own_clock in (False, True):
        vehicle = Vehicle(0.0, own_clock=own_clock)
        turned = vehicle.attitude_at
        vehicle.reported_at = lambda t_s, at=turned: se3.quat_multiply(  # type: ignore[method-assign,misc]
            se3.quat_from_euler(0.0, 0.0, 0.6 + math.radians(0.3) * t_s), at(t_s)
        )
        vehicle.fly(60)
        assert vehicle.told == []
        assert np.abs(vehicle.errors_s).max() < 0.01


@pytest.mark.parametrize("own_clock", [False, True])
@pytest.mark.parametrize("yaw_deg", [90, 180, -60])
def test_nor_is_a_camera_that_is_mounted_otherwise_than_configured(yaw_deg: int, own_clock: bool) -> None:
    vehicle = Vehicle(0.1, own_clock=own_clock)
    mounted, turn = se3.quat_from_euler(0.0, 0.0, math.radians(yaw_deg)), vehicle.turn

    def turned(k: int, given: dict[int, FrameRef]) -> Turn | None:
        seen = turn(k, given)
        if seen is None:
            return None
        return replace(seen, q_from_to=se3.quat_multiply(se3.quat_multiply(se3.quat_inverse(mounted), seen.q_from_to), mounted))

    vehicle.turn = turned  # type: ignore[method-assign]
    vehicle.fly(90)
    assert vehicle.told == []
    assert vehicle.errors_s[-1] > -0.5


def test_frames_with_other_offsets_are_not_compared() -> None:
    vehicle = Vehicle(1.0)
    vehicle.fly(12)
    changed = next(k for k, error_s in enumerate(vehicle.errors_s) if error_s < 0.5)
    before, *after = vehicle.given_ns[changed - 1 :]
    assert not vehicle.camera.alike(before, after[-1])
    assert vehicle.camera.alike(after[0], after[-1])
    assert vehicle.camera.alike(1, after[-1])
    assert vehicle.camera.outdated(before)
    assert not vehicle.camera.outdated(after[0])


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
