"""ODOMETRY (331): pose and velocity, with a quality.

The frames are what each autopilot takes (docs/mavlink.md): ArduPilot only LOCAL_FRD with BODY_FRD, whose position it then
reads as NED and whose velocity it turns by our attitude; PX4 would turn LOCAL_FRD by its heading's error and gets LOCAL_NED, for
the velocity, too. `estimator_type` VISION is one of those that PX4 takes with its covariances.
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.outputs.covariance import pose_triangle, sigma_m, velocity_triangle
from visloc_companion.adapters.mavlink.outputs.vision_position import stamp_us
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import quat_inverse, rotate
from visloc_companion.types import AutopilotKind, Cov2, Injection

HALF_QUALITY_M = 10.0
"""1-sigma of a position of quality 50 of 100."""


def odometry(injection: Injection, kind: AutopilotKind) -> Message | Reason:
    """The message of an injection whose numbers are sound; NOT_SEEDED where its velocity is not known.

    ArduPilot is given 1-sigma isotropic in the body's frame: it reads no covariance of a velocity, but others may.
    """
    velocity, cov_v = injection.v_ned_mps, injection.cov_v_ne_m2ps2
    if velocity is None or cov_v is None:
        return Reason.NOT_SEEDED
    frame, child = mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_LOCAL_NED
    if kind is AutopilotKind.ARDUPILOT:
        frame, child = mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_BODY_FRD
        velocity, cov_v = rotate(quat_inverse(injection.q_ned_frd), velocity), _isotropic(cov_v)
    return mav.MAVLink_odometry_message(
        stamp_us(injection),
        frame,
        child,
        *injection.p_ned_m,
        list(injection.q_ned_frd),
        *velocity,
        0.0,
        0.0,
        0.0,
        pose_triangle(injection, kind),
        velocity_triangle(cov_v),
        injection.reset_counter % 256,
        mav.MAV_ESTIMATOR_TYPE_VISION,
        quality(injection),
    )


def quality(injection: Injection) -> int:
    """1 (worst) to 100 by the 1-sigma of the position: 95 for 0.5 m, 50 for 10 m. 0 would be "unknown", -1 "failed"."""
    return max(1, min(100, round(100 / (1 + sigma_m(injection.cov_ne_m2) / HALF_QUALITY_M))))


def _isotropic(cov: Cov2) -> Cov2:
    variance = sigma_m(cov) ** 2
    return (variance, 0.0), (0.0, variance)
