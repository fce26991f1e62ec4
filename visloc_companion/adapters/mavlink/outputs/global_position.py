"""GLOBAL_POSITION_SENSOR (296): an auxiliary global position for PX4 of 2026 and later (EKF2_AGP*).

PX4 reads id, source (for its log only), lat, lon, alt, eph and epv, and nothing else: the time is that of arrival, a step cannot
be announced, and values that mean "unknown" are not looked for (mavlink_receiver.cpp, March 2026). eph is a standard deviation,
the same for both axes.
"""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mav
from visloc_companion.adapters.mavlink.outputs.covariance import sigma_m, vertical_sigma_m
from visloc_companion.adapters.mavlink.outputs.vision_position import stamp_us
from visloc_companion.types import Injection


def global_position_sensor(injection: Injection, system_id: int, sensor_id: int) -> Message:
    """The message of an injection whose numbers are sound. The ellipsoidal height is not known in flight: NaN."""
    place = injection.place
    return mav.MAVLink_global_position_sensor_message(
        system_id,
        AUTOPILOT_COMPONENT,
        sensor_id,
        stamp_us(injection),
        0,
        mav.GLOBAL_POSITION_SRC_VISION,
        0,
        e7(place.lat_deg),
        e7(place.lon_deg),
        math.nan,
        place.h_amsl_m,
        sigma_m(injection.cov_ne_m2),
        vertical_sigma_m(injection),
    )


def e7(degrees: float) -> int:
    """Degrees as the integer of MAVLink's places."""
    return round(degrees * 1e7)
