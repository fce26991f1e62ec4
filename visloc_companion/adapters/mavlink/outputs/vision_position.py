"""VISION_POSITION_ESTIMATE (102): the one pose message whose frame works unchanged on both autopilots."""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.outputs.covariance import pose_triangle
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import AutopilotKind, Injection


def vision_position_estimate(injection: Injection, kind: AutopilotKind) -> Message:
    """The message of an injection whose numbers are sound (soundness.py).

    `usec` is `Injection.t_ns` on our monotonic clock, the one that TIMESYNC replies show: one time base for all that we send,
    because ArduPilot keeps one jitter filter for the whole link. `z` is the injection's own (barometric) height.
    """
    return mav.MAVLink_vision_position_estimate_message(
        stamp_us(injection),
        *injection.p_ned_m,
        *euler_from_quat(injection.q_ned_frd),
        pose_triangle(injection, kind),
        injection.reset_counter % 256,
    )


def stamp_us(injection: Injection) -> int:
    """The time of validity on our monotonic clock, microseconds; never 0, which autopilots take for "now"."""
    return max(1, injection.t_ns // 1000)
