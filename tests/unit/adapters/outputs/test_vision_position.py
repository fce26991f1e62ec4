"""VISION_POSITION_ESTIMATE as each autopilot reads it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.vision_position import vision_position_estimate
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.types import AutopilotKind

SIGMA_M = st.floats(0.02, 99.0)
SIGMA_RAD = st.floats(0.002, 1.4)


def heard(message: object, kind: AutopilotKind) -> FakeAutopilot:
    autopilot = FakeAutopilot(kind=kind)
    autopilot.receive(message.pack(mav.MAVLink(None, 1, 197)))  # type: ignore[attr-defined]
    return autopilot


@given(sigma_m=SIGMA_M, ratio=st.floats(0.05, 1.0), angle=st.floats(0.0, math.pi), sigma_rad=SIGMA_RAD, sigma_d_m=SIGMA_M)
def test_ardupilot_believes_the_larger_semi_axis(injection, sigma_m, ratio, angle, sigma_rad, sigma_d_m):
    c, s = math.cos(angle), math.sin(angle)
    cov = np.array([[c, -s], [s, c]]) @ np.diag([sigma_m**2, (ratio * sigma_m) ** 2]) @ np.array([[c, s], [-s, c]])
    cov2 = ((float(cov[0, 0]), float(cov[0, 1])), (float(cov[1, 0]), float(cov[1, 1])))
    what = injection(cov_ne_m2=cov2, sigma_d_m=sigma_d_m, sigma_yaw_rad=sigma_rad)
    autopilot = heard(vision_position_estimate(what, AutopilotKind.ARDUPILOT), AutopilotKind.ARDUPILOT)
    assert autopilot.believed_sigma_m() == pytest.approx(sigma_m, rel=1e-4)
    assert autopilot.believed_angle_sigma_rad() == pytest.approx(sigma_rad, rel=1e-4)
    assert all(map(math.isfinite, autopilot.poses[0].covariance))


@given(sigma_n_m=SIGMA_M, sigma_e_m=SIGMA_M, correlation=st.floats(-0.99, 0.99), sigma_d_m=SIGMA_M, sigma_rad=SIGMA_RAD)
def test_px4_reads_variances(injection, wire, sigma_n_m, sigma_e_m, correlation, sigma_d_m, sigma_rad):
    ne = correlation * sigma_n_m * sigma_e_m
    cov = ((sigma_n_m**2, ne), (ne, sigma_e_m**2))
    what = injection(cov_ne_m2=cov, sigma_d_m=sigma_d_m, sigma_yaw_rad=sigma_rad)
    c = wire(vision_position_estimate(what, AutopilotKind.PX4)).covariance
    assert (c[0], c[1], c[6], c[11]) == pytest.approx((sigma_n_m**2, ne, sigma_e_m**2, sigma_d_m**2), rel=1e-5)
    assert c[20] == pytest.approx(sigma_rad**2, rel=1e-5)
    assert all(map(math.isfinite, c))


def test_position_attitude_time_and_counter_go_as_they_are(injection, wire):
    pose = wire(vision_position_estimate(injection(p_ned_m=(100.5, -20.25, -42.0)), AutopilotKind.ARDUPILOT))
    assert (pose.x, pose.y, pose.z, pose.usec, pose.reset_counter) == (100.5, -20.25, -42.0, 7_000_123, 3)
    assert (pose.roll, pose.pitch, pose.yaw) == pytest.approx((0.1, -0.2, 2.5), abs=1e-6)


def test_the_counter_is_a_byte_and_the_time_never_zero(injection, wire):
    pose = wire(vision_position_estimate(injection(reset_counter=257, t_ns=3), AutopilotKind.PX4))
    assert (pose.reset_counter, pose.usec) == (1, 1)


def test_the_published_pairs_of_ardupilot(injection):
    """Sent plainly as variances, sigma 0.5 and 1 m were read back as 0.57 and 1.44 m in flight."""
    for sigma_m, believed_m in ((0.5, 0.57), (1.0, 1.44)):
        what = injection(cov_ne_m2=((sigma_m**2, 0), (0, sigma_m**2)), sigma_d_m=sigma_m)
        autopilot = heard(vision_position_estimate(what, AutopilotKind.UNKNOWN), AutopilotKind.ARDUPILOT)
        assert autopilot.believed_sigma_m() == pytest.approx(believed_m, abs=0.01)
