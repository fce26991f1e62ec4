"""The messages of the simulated autopilot, built from one snapshot of its state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.sim.autopilots.streams import STATUS_MESSAGE
from visloc_companion.sim.estimators.estimator_status import EstimatorHealth
from visloc_companion.sim.gnss import HDOP, SPEED_ACC_MPS, GnssSample
from visloc_companion.sim.vehicle import GRAVITY_MPS2, wrap
from visloc_companion.types import AutopilotKind, GeoPoint, Quat, Vec3

FIRMWARE_VERSION = {AutopilotKind.ARDUPILOT: (4, 7, 0, 0), AutopilotKind.PX4: (1, 17, 0, 0)}
"""Major, minor, patch and FIRMWARE_VERSION_TYPE (0 = development) of what docs/ardupilot.md and docs/px4.md speak of."""
BOOT_UNIX_US = 1_750_000_000_000_000
"""Calendar time at which the simulated autopilot booted."""
GPS_BIT, VISION_BIT, XY_BIT = 1 << 5, 1 << 7, 1 << 14


@dataclass(frozen=True, slots=True)
class Ranged:
    """What the rangefinder measured (None: nothing came back), and between which distances it measures, m."""

    distance_m: float | None
    min_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The autopilot's state as it knows it. `place` is None where it sends no global position, `local` where no local one.

    `home` is as high as it takes the ground there to be. `dated`: whether its receiver has ever told it the time. From `place` on
    a field is as it is only where a message that tells it is to be sent.
    """

    kind: AutopilotKind
    t_boot_ns: int
    rpy_rad: Vec3
    rates_radps: Vec3
    p_ned_m: Vec3
    v_ned_mps: Vec3
    home: GeoPoint
    origin: GeoPoint | None
    local: bool
    gnss: GnssSample | None
    gnss_place: GeoPoint | None
    dated: bool
    health: EstimatorHealth
    baro_amsl_m: float
    external_healthy: bool
    mav_type: int
    custom_mode: int
    armed: bool
    failsafe: bool
    place: GeoPoint | None = None
    range: Ranged | None = None
    force_frd_mps2: Vec3 | None = None
    airspeed_mps: float = 0.0
    q_heading_gimbal: Quat | None = None

    @property
    def t_ms(self) -> int:
        """time_boot_ms."""
        return self.t_boot_ns // 1_000_000 & 0xFFFFFFFF

    @property
    def t_us(self) -> int:
        """time_usec."""
        return self.t_boot_ns // 1000


Message = Any
Builder = Callable[[Snapshot], Message | None]


def heartbeat(s: Snapshot) -> Message:
    """HEARTBEAT: type, autopilot, mode, armed."""
    ardupilot = s.kind is AutopilotKind.ARDUPILOT
    mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if s.armed else 0)
    state = mavlink.MAV_STATE_CRITICAL if s.failsafe else mavlink.MAV_STATE_ACTIVE if s.armed else mavlink.MAV_STATE_STANDBY
    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if ardupilot else mavlink.MAV_AUTOPILOT_PX4
    return mavlink.MAVLink_heartbeat_message(s.mav_type, autopilot, mode, s.custom_mode, state, 3)


def sys_status(s: Snapshot) -> Message:
    """SYS_STATUS: the GPS bit stays healthy without a fix (the receiver talks), vision's follows its messages."""
    present = GPS_BIT | VISION_BIT | XY_BIT
    healthy = GPS_BIT | (VISION_BIT if s.external_healthy else 0) | (XY_BIT if s.health.position_ok else 0)
    return mavlink.MAVLink_sys_status_message(present, present, healthy, 300, 15800, -1, -1, 0, 0, 0, 0, 0, 0)


def gps_raw_int(s: Snapshot) -> Message | None:
    """GPS_RAW_INT. Without a fix ArduPilot keeps the last accuracies, PX4 sends eph 10000 and h_acc 100 m."""
    if s.gnss is None or s.gnss_place is None:
        return None
    lost_px4 = s.kind is AutopilotKind.PX4 and not s.gnss.has_fix
    v_n, v_e, _ = s.gnss.v_ned_mps
    course_cdeg = round(math.degrees(math.atan2(v_e, v_n)) * 100) % 36000
    alt_mm = _whole(s.gnss_place.h_amsl_m * 1000, 32)
    return mavlink.MAVLink_gps_raw_int_message(
        s.t_us,
        s.gnss.fix_type,
        *_degrees_e7(s.gnss_place),
        alt_mm,
        10000 if lost_px4 else round(HDOP * 100),
        10000 if lost_px4 else round(HDOP * 150),
        min(round(math.hypot(v_n, v_e) * 100), 65534),
        course_cdeg,
        s.gnss.n_satellites,
        alt_mm,
        100000 if lost_px4 else round(s.gnss.h_acc_m * 1000),
        100000 if lost_px4 else round(s.gnss.v_acc_m * 1000),
        round(SPEED_ACC_MPS * 1000),
    )


def attitude(s: Snapshot) -> Message:
    """ATTITUDE."""
    roll, pitch, yaw = (wrap(angle) for angle in s.rpy_rad)
    return mavlink.MAVLink_attitude_message(s.t_ms, roll, pitch, yaw, *s.rates_radps)


def attitude_quaternion(s: Snapshot) -> Message:
    """ATTITUDE_QUATERNION."""
    return mavlink.MAVLink_attitude_quaternion_message(s.t_ms, *quat_from_euler(*s.rpy_rad), *s.rates_radps)


def local_position_ned(s: Snapshot) -> Message | None:
    """LOCAL_POSITION_NED, where the autopilot sends it."""
    return mavlink.MAVLink_local_position_ned_message(s.t_ms, *s.p_ned_m, *s.v_ned_mps) if s.local else None


def global_position_int(s: Snapshot) -> Message | None:
    """GLOBAL_POSITION_INT; ArduPilot sends latitude, longitude and altitude 0 before it has an origin, PX4 nothing."""
    if s.place is None and s.kind is AutopilotKind.PX4:
        return None
    place, above_home_m = s.place or GeoPoint(0.0, 0.0, 0.0), -s.p_ned_m[2]
    if s.place is not None:
        above_home_m = place.h_amsl_m - s.home.h_amsl_m
    return mavlink.MAVLink_global_position_int_message(
        s.t_ms,
        *_degrees_e7(place),
        _whole(place.h_amsl_m * 1000, 32),
        _whole(above_home_m * 1000, 32),
        *(_whole(v * 100, 16) for v in s.v_ned_mps),
        round(math.degrees(s.rpy_rad[2]) * 100) % 36000,
    )


def gps_global_origin(s: Snapshot) -> Message | None:
    """GPS_GLOBAL_ORIGIN, where there is one."""
    if s.origin is None:
        return None
    return mavlink.MAVLink_gps_global_origin_message(*_degrees_e7(s.origin), round(s.origin.h_amsl_m * 1000), s.t_us)


def home_position(s: Snapshot) -> Message | None:
    """HOME_POSITION, once there is an origin."""
    where = *_degrees_e7(s.home), round(s.home.h_amsl_m * 1000)
    message = mavlink.MAVLink_home_position_message(*where, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0, s.t_us)
    return None if s.origin is None else message


def scaled_pressure(s: Snapshot) -> Message:
    """SCALED_PRESSURE of the standard atmosphere at the barometer's height, and of the pitot tube; 15 degrees Celsius."""
    share = 1 - s.baro_amsl_m / 44330.77
    pressure_hpa = 1013.25 * share ** (1 / 0.190263)
    density = pressure_hpa * 100 / (287.05 * 288.15 * share)
    dynamic_hpa = density * s.airspeed_mps**2 / 200
    return mavlink.MAVLink_scaled_pressure_message(s.t_ms, pressure_hpa, dynamic_hpa, 1500)


def scaled_imu(s: Snapshot) -> Message | None:
    """SCALED_IMU: specific force in thousandths of g, rates in mrad/s."""
    if s.force_frd_mps2 is None:
        return None
    force = (_whole(f / GRAVITY_MPS2 * 1000, 16) for f in s.force_frd_mps2)
    return mavlink.MAVLink_scaled_imu_message(s.t_ms, *force, *(_whole(r * 1000, 16) for r in s.rates_radps), 0, 0, 0, 0)


def system_time(s: Snapshot) -> Message:
    """SYSTEM_TIME: calendar time, which goes on after the last fix; 0 before the first one gave it (PX4: a clock never set)."""
    return mavlink.MAVLink_system_time_message(BOOT_UNIX_US + s.t_us if s.dated else 0, s.t_ms)


def autopilot_version(s: Snapshot) -> Message:
    """AUTOPILOT_VERSION."""
    major, minor, patch, kind = FIRMWARE_VERSION[s.kind]
    version = major << 24 | minor << 16 | patch << 8 | kind
    bytewise, as_float = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE, mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | (bytewise if s.kind is AutopilotKind.PX4 else as_float)
    return mavlink.MAVLink_autopilot_version_message(capabilities, version, 0, 0, 0, b"\0" * 8, b"\0" * 8, b"\0" * 8, 0, 0, 1)


def ekf_status_report(s: Snapshot) -> Message:
    """EKF_STATUS_REPORT (ArduPilot): roots of the test ratios."""
    h = s.health
    return mavlink.MAVLink_ekf_status_report_message(
        h.flags, math.sqrt(h.velocity_ratio), math.sqrt(h.position_ratio), math.sqrt(h.height_ratio), 0.05, 0.0
    )


def estimator_status(s: Snapshot) -> Message:
    """ESTIMATOR_STATUS (PX4): test ratios."""
    h = s.health
    ratios = (math.sqrt(ratio) for ratio in (h.velocity_ratio, h.position_ratio, h.height_ratio))
    return mavlink.MAVLink_estimator_status_message(s.t_us, h.flags, *ratios, 0.05, 0.0, 0.0, 0.5, 0.5)


def distance_sensor(s: Snapshot) -> Message | None:
    """DISTANCE_SENSOR looking down, where there is one; what is out of reach is sent as farther than it measures."""
    if s.range is None:
        return None
    far_cm = min(round(s.range.max_m * 100), 0xFFFF - 1)
    distance_cm = far_cm + 1 if s.range.distance_m is None else min(round(s.range.distance_m * 100), 0xFFFF)
    laser, down = mavlink.MAV_DISTANCE_SENSOR_LASER, mavlink.MAV_SENSOR_ROTATION_PITCH_270
    return mavlink.MAVLink_distance_sensor_message(s.t_ms, round(s.range.min_m * 100), far_cm, distance_cm, laser, 0, down, 255)


GIMBAL_FLAGS = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
)


def gimbal_device_attitude_status(s: Snapshot) -> Message | None:
    """GIMBAL_DEVICE_ATTITUDE_STATUS of the only gimbal, where there is one.

    ArduPilot states neither rates nor the heading (AP_Mount_Backend.cpp, send_gimbal_device_attitude_status; its simulator sends
    the same), PX4 leaves them zero (output_rc.cpp).
    """
    if s.q_heading_gimbal is None:
        return None
    unstated = math.nan if s.kind is AutopilotKind.ARDUPILOT else 0.0
    rates, heading = (unstated,) * 3, (unstated,) * 2
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, s.t_ms, GIMBAL_FLAGS, s.q_heading_gimbal, *rates, 0, *heading, 1
    )


BUILDERS: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw_int,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: scaled_pressure,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: scaled_imu,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: distance_sensor,
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: gimbal_device_attitude_status,
    STATUS_MESSAGE[AutopilotKind.ARDUPILOT]: ekf_status_report,
    STATUS_MESSAGE[AutopilotKind.PX4]: estimator_status,
}


def _degrees_e7(place: GeoPoint) -> tuple[int, int]:
    return _whole(place.lat_deg * 1e7, 32), _whole(place.lon_deg * 1e7, 32)


def _whole(value: float, bits: int) -> int:
    """Rounded and held within a signed field (an estimate that follows nonsense must not break the link)."""
    limit = float(2 ** (bits - 1) - 1)
    return round(min(max(value, -limit), limit))
