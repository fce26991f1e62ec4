"""GIMBAL_DEVICE_ATTITUDE_STATUS (285) to an event, of an autopilot and of a gimbal that speaks MAVLink itself.

What its yaw counts from is in its flags (common.xml); without one of the two frame flags the yaw lock decides. `delta_yaw` is not
used: ArduPilot sends NaN, PX4 leaves 0, and the vehicle's heading is known here. MOUNT_ORIENTATION, which it took the place of,
is not read.
"""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.codec_gnss import Outcome
from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, GIMBAL_COMPONENTS, Message, mav
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import normalised
from visloc_companion.types import GimbalAttitude, GimbalFrame

_NS_PER_MS = 1_000_000
NAME = "GIMBAL_DEVICE_ATTITUDE_STATUS"
_WORTHLESS = (
    mav.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_SOFTWARE_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_COMMS_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_CALIBRATION_RUNNING
)
"""A gimbal at one of its limits, or whose motors fail, still knows where it points."""


def frame_of(flags: int) -> GimbalFrame | None:
    """What an attitude counts from by its GIMBAL_DEVICE_FLAGS; None for both frames at once, which is not allowed."""
    of_vehicle = bool(flags & mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME)
    of_earth = bool(flags & mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
    if of_vehicle and of_earth:
        return None
    if not of_vehicle and not of_earth:
        of_earth = bool(flags & mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK)
    return GimbalFrame.NORTH if of_earth else GimbalFrame.HEADING


def has_failed(failure_flags: int) -> bool:
    """Whether an attitude is worth nothing by its GIMBAL_DEVICE_ERROR_FLAGS."""
    return bool(failure_flags & _WORTHLESS)


def is_of_gimbal(msg: Message) -> bool:
    """Whether a gimbal's own component says how it points."""
    return msg.get_srcComponent() in GIMBAL_COMPONENTS and msg.get_type() == NAME


def gimbal_attitude(msg: Message, t_rx_ns: int) -> Outcome:
    """NOT_FINITE or BAD_INPUT for what is no attitude, or has an impossible frame."""
    q, frame, t_ns = tuple(map(float, msg.q)), frame_of(msg.flags), msg.time_boot_ms * _NS_PER_MS
    if not all(map(math.isfinite, q)):
        return Reason.NOT_FINITE
    if not 0.9 < math.hypot(*q) < 1.1 or frame is None:
        return Reason.BAD_INPUT
    component = msg.get_srcComponent()
    of_autopilot = component == AUTOPILOT_COMPONENT
    return GimbalAttitude(
        t_rx_ns,
        t_ns if of_autopilot else 0,
        (msg.gimbal_device_id or 1) if of_autopilot else component,
        normalised((q[0], q[1], q[2], q[3])),
        frame,
        has_failed(msg.failure_flags),
        None if of_autopilot else t_ns,
    )
