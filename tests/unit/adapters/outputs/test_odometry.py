"""ODOMETRY in the frames that each autopilot takes."""

import math

import numpy as np
import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.odometry import odometry, quality
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import rotate
from visloc_companion.types import AutopilotKind

ARDUPILOT, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4


def test_ardupilot_takes_ned_under_the_name_of_local_frd(injection, wire):
    what = injection()
    got = wire(odometry(what, ARDUPILOT))
    assert (got.frame_id, got.child_frame_id) == (mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_BODY_FRD) == (20, 12)
    assert (got.x, got.y, got.z) == pytest.approx(what.p_ned_m)
    turned_back = rotate(tuple(got.q), (got.vx, got.vy, got.vz))  # as GCS_Common.cpp does: vel = q * vel
    assert turned_back == pytest.approx(what.v_ned_mps, abs=1e-5)
    c = got.pose_covariance
    believed_m = (c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1 / 3)
    assert believed_m == pytest.approx(math.sqrt(np.linalg.eigvalsh(np.array(what.cov_ne_m2))[1]), rel=1e-4)


def test_px4_gets_local_ned_never_local_frd(injection, wire):
    what = injection(PX4)
    got = wire(odometry(what, PX4))
    assert (got.frame_id, got.child_frame_id) == (mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_LOCAL_NED) == (1, 1)
    assert (got.vx, got.vy, got.vz) == pytest.approx(what.v_ned_mps)
    c, v = got.pose_covariance, got.velocity_covariance
    assert (c[0], c[1], c[6], c[11]) == pytest.approx((4.0, 0.5, 1.0, 9.0))
    assert (v[0], v[1], v[6]) == pytest.approx((0.36, 0.05, 0.16))
    assert v[11] == 100.0  # the vertical velocity is PX4's own: coming back it must teach nothing
    assert got.estimator_type == mav.MAV_ESTIMATOR_TYPE_VISION


@pytest.mark.parametrize("kind", [ARDUPILOT, PX4])
def test_every_entry_is_finite_and_no_variance_is_zero(injection, wire, kind):
    got = wire(odometry(injection(kind), kind))
    for triangle in (got.pose_covariance, got.velocity_covariance):
        assert all(map(math.isfinite, triangle))
        assert all(triangle[k] > 0 for k in (0, 6, 11, 15, 18, 20))


@pytest.mark.parametrize(("sigma_m", "expected"), [(0.5, 95), (1.0, 91), (10.0, 50), (60.0, 14), (1000.0, 1)])
def test_quality_falls_with_sigma_and_is_never_unknown_or_failed(injection, sigma_m, expected):
    assert quality(injection(cov_ne_m2=((sigma_m**2, 0.0), (0.0, sigma_m**2)))) == expected


@pytest.mark.parametrize("change", [{"v_ned_mps": None}, {"cov_v_ne_m2ps2": None}])
def test_there_is_none_without_a_velocity(injection, change):
    assert odometry(injection(**change), PX4) is Reason.NOT_SEEDED
