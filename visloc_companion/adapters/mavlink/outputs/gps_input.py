"""GPS_INPUT (232): a receiver of type 14 (MAVLink) of ArduPilot.

Without a velocity ArduPilot's EKF failed within 1.2 s, so none is sent then. The height is the autopilot's own and the vertical
velocity is left out: the estimator's height must not rest on this receiver (EK3_SRCn_POSZ other than 3).
"""

from __future__ import annotations

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.outputs.covariance import sigma_m, vertical_sigma_m
from visloc_companion.adapters.mavlink.outputs.global_position import e7
from visloc_companion.adapters.mavlink.outputs.vision_position import stamp_us
from visloc_companion.errors import Reason
from visloc_companion.types import Injection

IGNORED = mav.GPS_INPUT_IGNORE_FLAG_VDOP | mav.GPS_INPUT_IGNORE_FLAG_VEL_VERT  # all else is given
SATELLITES = 10
"""ArduPilot aligns with no fewer than six; there are none."""
RANGE_ERROR_M, MAX_HDOP = 1.0, 99.99
_GPS_EPOCH_NS, _LEAP_NS, _WEEK_NS = 315_964_800 * 10**9, 18 * 10**9, 604_800 * 10**9
"""GPS time begins on 6 January 1980 and has been 18 s ahead of UTC since 2017."""


def gps_input(injection: Injection, gps_id: int, t_unix_ns: int | None) -> Message | Reason:
    """The message of an injection whose numbers are sound; NOT_SEEDED where its velocity is not known.

    `gps_id` is the receiver's number from 0: ArduPilot passes over any other. `t_unix_ns` is the calendar's time of validity,
    from which GPS week and time of week come; where it is None week 0 says that they are not known. hdop is the 1-sigma in
    units of a receiver's range error of 1 m.
    """
    velocity, cov_v = injection.v_ned_mps, injection.cov_v_ne_m2ps2
    if velocity is None or cov_v is None:
        return Reason.NOT_SEEDED
    week, week_ms = gps_time(t_unix_ns)
    sigma = sigma_m(injection.cov_ne_m2)
    place = injection.place
    return mav.MAVLink_gps_input_message(
        stamp_us(injection),
        gps_id,
        IGNORED,
        week_ms,
        week,
        mav.GPS_FIX_TYPE_3D_FIX,
        e7(place.lat_deg),
        e7(place.lon_deg),
        place.h_amsl_m,
        min(MAX_HDOP, sigma / RANGE_ERROR_M),
        0.0,
        velocity[0],
        velocity[1],
        0.0,
        sigma_m(cov_v),
        sigma,
        vertical_sigma_m(injection),
        SATELLITES,
    )


def gps_time(t_unix_ns: int | None) -> tuple[int, int]:
    """GPS week and milliseconds of the week of a time of UTC; 0, 0 where it is not known."""
    if t_unix_ns is None:
        return 0, 0
    since_ns = t_unix_ns - _GPS_EPOCH_NS + _LEAP_NS
    week, rest_ns = divmod(since_ns, _WEEK_NS)
    return (week, rest_ns // 1_000_000) if 0 < week < 65536 else (0, 0)
