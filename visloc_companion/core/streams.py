"""Which MAVLink messages the core needs, and at what rate."""

from __future__ import annotations

from visloc_companion.core.settings import CoreSettings
from visloc_companion.types import AutopilotKind, Command, RequestMessage

ATTITUDE, LOCAL_POSITION_NED, GLOBAL_POSITION_INT, GPS_RAW_INT, GPS_GLOBAL_ORIGIN = 30, 32, 33, 24, 49
SCALED_IMU = 26
EKF_STATUS_REPORT, ESTIMATOR_STATUS = 193, 230
SYSTEM_TIME, SCALED_PRESSURE, EVIDENCE_RATE_HZ = 2, 29, 1.0
"""What bears on the GNSS verdict only."""
DISTANCE_SENSOR, RANGE_RATE_HZ = 132, 10.0
GIMBAL_DEVICE_ATTITUDE_STATUS = 285
STATUS_MESSAGES = {
    AutopilotKind.ARDUPILOT: (EKF_STATUS_REPORT,),
    AutopilotKind.PX4: (ESTIMATOR_STATUS,),
    AutopilotKind.UNKNOWN: (EKF_STATUS_REPORT, ESTIMATOR_STATUS),
}
ORIGIN_REQUEST = RequestMessage(GPS_GLOBAL_ORIGIN, 0.0)


def requests_for(autopilot: AutopilotKind, settings: CoreSettings) -> list[Command]:
    """The requests on a new link; the origin is asked for once (and again until it is there)."""
    return [
        RequestMessage(ATTITUDE, settings.attitude_rate_hz),
        RequestMessage(GLOBAL_POSITION_INT, settings.position_rate_hz),
        RequestMessage(LOCAL_POSITION_NED, settings.position_rate_hz),
        RequestMessage(GPS_RAW_INT, settings.gnss_rate_hz),
        RequestMessage(SCALED_IMU, settings.attitude_rate_hz),
        *([RequestMessage(GIMBAL_DEVICE_ATTITUDE_STATUS, settings.gimbal.rate_hz)] if settings.gimbal else []),
        *([RequestMessage(DISTANCE_SENSOR, RANGE_RATE_HZ)] if settings.terrain or settings.rangefinder else []),
        *(RequestMessage(message_id, settings.status_rate_hz) for message_id in STATUS_MESSAGES[autopilot]),
        RequestMessage(SCALED_PRESSURE, EVIDENCE_RATE_HZ),
        RequestMessage(SYSTEM_TIME, EVIDENCE_RATE_HZ),
        ORIGIN_REQUEST,
    ]
