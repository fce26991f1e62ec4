"""The one place that names the MAVLink dialect: pymavlink's ArduPilot dialect, wire format 2.

`ardupilotmega` holds all of `common` and, beyond it, EKF_STATUS_REPORT and RANGEFINDER. It is imported directly, never through
`mavutil`, whose default is MAVLink 1 (there VISION_POSITION_ESTIMATE has neither covariance nor reset_counter). GNSS_INTEGRITY
is still in the `development` dialect only; its one message is added to what the parser knows.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega, development

mav: Any = ardupilotmega
Message = Any
"""A decoded MAVLink message of any pymavlink dialect, version 1 or 2: `get_type()` and named fields."""

mav.mavlink_map.setdefault(development.MAVLINK_MSG_ID_GNSS_INTEGRITY, development.MAVLink_gnss_integrity_message)

AUTOPILOT_COMPONENT = 1
GIMBAL_COMPONENTS = frozenset(
    (
        mav.MAV_COMP_ID_GIMBAL,
        mav.MAV_COMP_ID_GIMBAL2,
        mav.MAV_COMP_ID_GIMBAL3,
        mav.MAV_COMP_ID_GIMBAL4,
        mav.MAV_COMP_ID_GIMBAL5,
        mav.MAV_COMP_ID_GIMBAL6,
    )
)
GLOBAL_FRAMES = (
    mav.MAV_FRAME_GLOBAL,
    mav.MAV_FRAME_GLOBAL_INT,
    mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
"""MAV_FRAME of latitude and longitude; they differ in the height."""
NO_AUTOPILOT_TYPES = frozenset(
    (
        mav.MAV_TYPE_GCS,
        mav.MAV_TYPE_ONBOARD_CONTROLLER,
        mav.MAV_TYPE_GIMBAL,
        mav.MAV_TYPE_ADSB,
        mav.MAV_TYPE_CAMERA,
        mav.MAV_TYPE_ANTENNA_TRACKER,
    )
)
"""MAV_TYPE of those that send heartbeats on a vehicle's link and do not fly it."""
