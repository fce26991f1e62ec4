"""Injections as each autopilot reads them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.encode import (
    command_long,
    float_of_int32,
    int32_of_float,
    param_set_int32,
    statustext,
    vision_position_estimate,
)
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import AutopilotKind, Cov2, GeoPoint, Injection, Notice, Severity

PLACE = GeoPoint(47.0, 8.0, 500.0)
SIGMA_M = st.floats(0.02, 99.0)
SIGMA_RAD = st.floats(0.002, 1.4)


def injection(
    cov: Cov2 = ((1.0, 0.0), (0.0, 1.0)), sigma_d_m: float = 1.0, sigma_yaw_rad: float = 0.1, **kw: object
) -> Injection:
    values: dict[str, object] = {
        "t_ns": 1_500_000,
        "p_ned_m": (1.0, 2.0, -3.0),
        "q_ned_frd": (1.0, 0.0, 0.0, 0.0),
        "reset_counter": 3,
    }
    values |= kw
    return Injection(place=PLACE, cov_ne_m2=cov, sigma_d_m=sigma_d_m, sigma_yaw_rad=sigma_yaw_rad, **values)  # type: ignore[arg-type]


def over_the_wire(message: object, kind: AutopilotKind = AutopilotKind.ARDUPILOT) -> FakeAutopilot:
    autopilot = FakeAutopilot(kind=kind)
    autopilot.receive(message.pack(mav.MAVLink(None, 1, 197)))  # type: ignore[attr-defined]
    return autopilot


@given(sigma_m=SIGMA_M, ratio=st.floats(0.05, 1.0), angle=st.floats(0.0, math.pi), sigma_rad=SIGMA_RAD, sigma_d_m=SIGMA_M)
def test_ardupilot_believes_the_larger_semi_axis(sigma_m, ratio, angle, sigma_rad, sigma_d_m):
    c, s = math.cos(angle), math.sin(angle)
    cov = np.array([[c, -s], [s, c]]) @ np.diag([sigma_m**2, (ratio * sigma_m) ** 2]) @ np.array([[c, s], [-s, c]])
    cov2 = ((float(cov[0, 0]), float(cov[0, 1])), (float(cov[1, 0]), float(cov[1, 1])))
    message = vision_position_estimate(injection(cov2, sigma_d_m, sigma_rad), AutopilotKind.ARDUPILOT)
    autopilot = over_the_wire(message)
    assert autopilot.believed_sigma_m() == pytest.approx(sigma_m, rel=1e-4)
    assert autopilot.believed_angle_sigma_rad() == pytest.approx(sigma_rad, rel=1e-4)
    assert all(map(math.isfinite, autopilot.poses[0].covariance))


@given(sigma_n_m=SIGMA_M, sigma_e_m=SIGMA_M, correlation=st.floats(-0.99, 0.99), sigma_d_m=SIGMA_M, sigma_rad=SIGMA_RAD)
def test_px4_reads_variances(sigma_n_m, sigma_e_m, correlation, sigma_d_m, sigma_rad):
    ne = correlation * sigma_n_m * sigma_e_m
    cov = ((sigma_n_m**2, ne), (ne, sigma_e_m**2))
    message = vision_position_estimate(injection(cov, sigma_d_m, sigma_rad), AutopilotKind.PX4)
    c = over_the_wire(message, AutopilotKind.PX4).poses[0].covariance
    assert (c[0], c[1], c[6], c[11]) == pytest.approx((sigma_n_m**2, ne, sigma_e_m**2, sigma_d_m**2), rel=1e-5)
    assert c[20] == pytest.approx(sigma_rad**2, rel=1e-5)
    assert all(map(math.isfinite, c))


finite_or_not = st.floats(width=64)


@given(
    numbers=st.lists(finite_or_not, min_size=13, max_size=13),
    kind=st.sampled_from(list(AutopilotKind)),
    counter=st.integers(0, 10_000),
)
def test_whatever_the_numbers_the_message_is_finite_or_refused(numbers, kind, counter):
    x, y, z, qw, qx, qy, qz, nn, ne, en, ee, d, yaw = numbers
    what = injection(((nn, ne), (en, ee)), d, yaw, p_ned_m=(x, y, z), q_ned_frd=(qw, qx, qy, qz), reset_counter=counter)
    message = vision_position_estimate(what, kind)
    if isinstance(message, Reason):
        return
    pose = over_the_wire(message, kind).poses[0]
    assert all(map(math.isfinite, (pose.x, pose.y, pose.z, pose.roll, pose.pitch, pose.yaw, *pose.covariance)))
    assert pose.covariance[0] > 0
    assert pose.reset_counter == counter % 256


@pytest.mark.parametrize("field", range(4))
def test_not_finite_is_refused(field):
    nan = float("nan")
    wrong = (
        injection(p_ned_m=(nan, 0.0, 0.0)),
        injection(((nan, 0.0), (0.0, 1.0))),
        injection(sigma_d_m=float("inf")),
        injection(q_ned_frd=(1.0, nan, 0.0, 0.0)),
    )[field]
    assert vision_position_estimate(wrong, AutopilotKind.PX4) is Reason.NOT_FINITE


def test_position_attitude_time_and_counter_go_as_they_are():
    what = injection(t_ns=7_000_123_456, q_ned_frd=quat_from_euler(0.1, -0.2, 2.5), p_ned_m=(100.5, -20.25, -42.0))
    pose = over_the_wire(vision_position_estimate(what, AutopilotKind.ARDUPILOT)).poses[0]
    assert (pose.x, pose.y, pose.z, pose.usec, pose.reset_counter) == (100.5, -20.25, -42.0, 7_000_123, 3)
    assert (pose.roll, pose.pitch, pose.yaw) == pytest.approx((0.1, -0.2, 2.5), abs=1e-6)


def test_the_published_pairs_of_ardupilot():
    """Sent plainly as variances, sigma 0.5 and 1 m were read back as 0.57 and 1.44 m in flight."""
    autopilot = FakeAutopilot()
    for sigma_m, believed_m in ((0.5, 0.57), (1.0, 1.44)):
        message = vision_position_estimate(injection(((sigma_m**2, 0), (0, sigma_m**2)), sigma_m), AutopilotKind.UNKNOWN)
        autopilot.receive(message.pack(mav.MAVLink(None, 1, 197)))
        assert autopilot.believed_sigma_m() == pytest.approx(believed_m, abs=0.01)


@given(value=st.integers(0, 2**31 - 1).filter(lambda v: v < 0x7F800000))
def test_integer_parameters_travel_as_bytes(value):
    message = param_set_int32(1, "EKF2_GPS_CTRL", value)
    packer = mav.MAVLink(None, 1, 197)
    again = packer.decode(bytearray(message.pack(packer)))
    assert int32_of_float(again.param_value) == value
    assert (again.param_id, again.param_type) == ("EKF2_GPS_CTRL", 6)


def test_seven_is_not_sent_as_seven():
    assert float_of_int32(7) == pytest.approx(9.8e-45, rel=0.01)


def test_texts_and_commands():
    text = statustext(Notice(Severity.WARNING, "GNSS über 30 m off" + "!" * 50))
    assert (text.severity, len(text.text)) == (mav.MAV_SEVERITY_WARNING, 50)
    command = command_long(4, 511, 30.0, 20000.0)
    assert (command.target_system, command.target_component, command.command) == (4, 1, 511)
    assert (command.param1, command.param2, command.param3, command.param7) == (30.0, 20000.0, 0.0, 0.0)
