"""How the simulated autopilot's filter errs with a quiet and with a noisy inertial sensor."""

from __future__ import annotations

import math
import statistics
from random import Random

import pytest

from visloc_companion.sim.estimators.estimator import Fixed, InertialFilter
from visloc_companion.sim.vehicles.imu import EKF3, NOISY, QUIET, Imu

LAG_S, DT_S = 0.2, 0.01


def flown(imu: Imu, seconds: float = 120.0, yaw_rad: float = 0.0) -> tuple[InertialFilter, list[float], list[float], list[float]]:
    """A vehicle at rest with positions of 0.7 m ten times a second: errors of position, velocity and tilt (degrees), north."""
    filter_, rng = InertialFilter(Random(1), LAG_S, DT_S, imu), Random(2)
    filter_.align((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    p: list[float] = []
    v: list[float] = []
    tilt: list[float] = []
    for step in range(round(seconds / DT_S)):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S, yaw_rad)
        if step % 10 == 0:
            filter_.fuse(Fixed(filter_.t_delayed_s, rng.gauss(0.0, 0.7), rng.gauss(0.0, 0.7), 0.49, 0.49))
            p.append(filter_.north.p_now)
            v.append(filter_.north.v_now)
            tilt.append(math.degrees(filter_.tilt_ne_rad[1]))
    return filter_, p[200:], v[200:], tilt[200:]


def test_a_quiet_sensor_does_not_tilt() -> None:
    _, p, v, tilt = flown(QUIET)
    assert set(tilt) == {0.0}
    assert statistics.pstdev(p) < 0.45
    assert statistics.pstdev(v) < 0.35


def test_a_noisy_one_tilts_as_much_as_px4s_did() -> None:
    """Its own simulator's log: roll 1.2°, pitch 0.7° (1-sigma); heading north-east both axes have the mean of both."""
    _, p, v, tilt = flown(NOISY, yaw_rad=math.pi / 4)
    assert 0.4 < statistics.pstdev(tilt) < 1.5
    assert 0.3 < statistics.pstdev(v) < 0.7
    assert statistics.pstdev(p) < 1.0  # of positions that are not correlated


def test_ekf3_takes_a_false_position_for_a_tilt() -> None:
    """In the real one's flights the accelerations answered a step of 1 m by 0.05 m/s² after 2 s, by half of it after 5 s."""
    filter_, answers = InertialFilter(Random(1), LAG_S, DT_S, EKF3), []
    filter_.align((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for step in range(6800):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S)
        if step % 10 == 0:
            filter_.fuse(Fixed(filter_.t_delayed_s, 1.0 if step >= 6000 else 0.0, 0.0, 0.49, 0.49))
        if step >= 6000 and step % 100 == 0:
            answers.append(filter_.north.tilt)
    assert answers[2] == pytest.approx(0.04, abs=0.02)
    assert max(answers) < 0.06 and answers[5] < 0.5 * answers[2]


@pytest.mark.parametrize(("heading_deg", "more"), [(0.0, "roll"), (90.0, "pitch")])
def test_px4s_tilts_about_its_forward_axis_most(heading_deg: float, more: str) -> None:
    """Its own simulator's logs: roll 1.1 to 1.25°, pitch 0.6 to 0.8° (1-sigma). Heading north it rolls about north."""
    filter_, about_north, about_east = InertialFilter(Random(1), LAG_S, DT_S, NOISY), [], []
    filter_.align((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for step in range(24000):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S, math.radians(heading_deg))
        if step % 10 == 0:
            filter_.fuse(Fixed(filter_.t_delayed_s, 0.0, 0.0, 0.49, 0.49))
            about_north.append(math.degrees(filter_.tilt_ne_rad[0]))
            about_east.append(math.degrees(filter_.tilt_ne_rad[1]))
    roll, pitch = (about_north, about_east) if more == "roll" else (about_east, about_north)
    assert statistics.pstdev(roll[200:]) > 1.4 * statistics.pstdev(pitch[200:])


def test_ekf3s_attitude_answers_as_in_its_own_logs() -> None:
    """ArduCopter with positions of 3.13 m, ten a second: 0.0235 m/s³ a metre of innovation, R² 0.94; errRP of XKF4 0.0096."""
    filter_, sigma_m = InertialFilter(Random(1), LAG_S, DT_S, EKF3), 3.13
    filter_.align((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for step in range(12000):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S)
        if step % 10 == 0:
            filter_.fuse(Fixed(filter_.t_delayed_s, 0.0, 0.0, sigma_m**2, sigma_m**2))
    axis = filter_.north
    before = axis.tilt
    filter_.fuse(Fixed(filter_.t_delayed_s, axis.p + 1.0, 0.0, sigma_m**2, sigma_m**2))
    assert (axis.tilt - before) / 0.1 == pytest.approx(0.0235, rel=0.15)
    assert math.sqrt(2 * axis.P33) / 9.81 == pytest.approx(0.0096, rel=0.15)


@pytest.mark.parametrize("imu", [EKF3, NOISY], ids=["EKF3", "SIH"])
def test_a_bias_that_drifts_does_not_part_the_present_from_the_delayed_state(imu: Imu) -> None:
    """At rest they differ by what the velocity is off, over the lag."""
    filter_, *_ = flown(imu, 240.0)
    for axis in (filter_.north, filter_.east):
        assert axis.drift != 0.0
        assert axis.p_now == pytest.approx(axis.p, abs=0.5)


def test_the_present_follows_the_delayed_state_also_after_a_time_without_position() -> None:
    filter_, *_ = flown(NOISY, 20.0)
    for _ in range(300):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S)
        filter_.hold()
    assert filter_.tilt_ne_rad == pytest.approx((0.0, 0.0), abs=1e-3)
    filter_.reset_to(Fixed(filter_.t_delayed_s, 5.0, 5.0, 0.49, 0.49))
    for step in range(6000):
        filter_.step((0.0, 0.0, 0.0), 0.0, 0.0, DT_S)
        if step % 10 == 0:
            filter_.fuse(Fixed(filter_.t_delayed_s, 5.0, 5.0, 0.49, 0.49))
    assert filter_.north.p_now == pytest.approx(5.0, abs=1.5)
