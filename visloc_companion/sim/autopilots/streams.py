"""Which messages the simulated autopilot streams, and when: only what was asked for."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.types import AutopilotKind

COMMON = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION,
        mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
        mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
    }
)
STATUS_MESSAGE = {
    AutopilotKind.ARDUPILOT: mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    AutopilotKind.PX4: mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
}
LOOP_RATE_HZ = {"copter": 400.0, "plane": 50.0}


class Streams:
    """The table of requested intervals. ArduPilot denies more than 0.8 of its loop rate (a plane: 40 Hz), -1 stops.

    (ArduPilot's GCS_Common.cpp:262, PX4's mavlink_receiver.cpp:2236, both of July 2025)
    """

    def __init__(self, kind: AutopilotKind, vehicle: str) -> None:
        self._kind = kind
        self._max_rate_hz = 0.8 * LOOP_RATE_HZ[vehicle] if kind is AutopilotKind.ARDUPILOT else math.inf
        self.available = COMMON | {STATUS_MESSAGE[kind]}
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._next_s = math.inf

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> int:
        """Take MAV_CMD_SET_MESSAGE_INTERVAL; returns the MAV_RESULT. 0 asks for the default, which is off."""
        if message_id not in self.available:
            return int(mavlink.MAV_RESULT_FAILED)
        if interval_us <= 0:
            if self._kind is AutopilotKind.ARDUPILOT and interval_us not in (0, -1):
                return int(mavlink.MAV_RESULT_DENIED)
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            self._next_s = min(self._due_s.values(), default=math.inf)
            return int(mavlink.MAV_RESULT_ACCEPTED)
        if 1e6 / interval_us > self._max_rate_hz:
            return int(mavlink.MAV_RESULT_DENIED)
        self._interval_s[message_id] = interval_us / 1e6
        self._due_s[message_id] = now_s
        self._next_s = min(self._next_s, now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def due(self, now_s: float) -> list[int]:
        """The messages to send now."""
        if now_s + 1e-9 < self._next_s:
            return []
        ready = [message_id for message_id, t_s in self._due_s.items() if t_s <= now_s + 1e-9]
        for message_id in ready:
            self._due_s[message_id] = max(self._due_s[message_id] + self._interval_s[message_id], now_s - 0.1)
        self._next_s = min(self._due_s.values(), default=math.inf)
        return ready
