"""MAVLink messages to events. Works on message objects of MAVLink 1 and 2 alike, so that the readers of logs share it.

An event is made only of finite, plausible values: what is not is dropped whole, with a `Reason`. Values that a message marks as
unknown (65535, 255, 0, or an extension that MAVLink 1 lacks) become None.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from visloc_companion.adapters.mavlink import codec_gimbal, codec_gnss
from visloc_companion.adapters.mavlink.codec_gnss import Outcome, place, wrapped_ns
from visloc_companion.adapters.mavlink.dialect import NO_AUTOPILOT_TYPES, Message, mav
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import normalised, quat_from_euler
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Baro,
    EstimatorStatus,
    Event,
    Imu,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
    Range,
    Vec3,
)

_NS_PER_MS = 1_000_000
_UNKNOWN_VARIANCE = 255
_MILLI_G_MPS2 = 9.80665e-3
_VERSION_TYPES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))
_KINDS = {mav.MAV_AUTOPILOT_ARDUPILOTMEGA: AutopilotKind.ARDUPILOT, mav.MAV_AUTOPILOT_PX4: AutopilotKind.PX4}


def decode(msg: Message, t_rx_ns: int) -> list[Event]:
    """The events in one message (none or one), stamped with its arrival.

    HEARTBEAT and AUTOPILOT_VERSION give a LinkChanged each time; `link_state.LinkState` merges them and passes changes only.
    TIMESYNC, COMMAND_ACK and PARAM_VALUE belong to a conversation and are the session's work. Every `t_boot_ns` is 0
    where the message carries no boot time.
    """
    outcome = examine(msg, t_rx_ns)
    return [] if outcome is None or isinstance(outcome, Reason) else [outcome]


def examine(msg: Message, t_rx_ns: int) -> Outcome:
    """Like `decode`, but names the reason where the message is dropped."""
    handler = _HANDLERS.get(msg.get_type())
    return None if handler is None else handler(msg, t_rx_ns)


def _finite(msg: Message, *names: str) -> tuple[float, ...] | None:
    values = tuple(float(getattr(msg, name)) for name in names)
    return values if all(map(math.isfinite, values)) else None


def _vec3(msg: Message, *names: str) -> Vec3 | None:
    values = _finite(msg, *names)
    return None if values is None else (values[0], values[1], values[2])


def _attitude(msg: Message, t_rx_ns: int) -> Outcome:
    angles, rates = _vec3(msg, "roll", "pitch", "yaw"), _vec3(msg, "rollspeed", "pitchspeed", "yawspeed")
    if angles is None or rates is None:
        return Reason.NOT_FINITE
    return Attitude(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, quat_from_euler(*angles), rates)


def _attitude_quaternion(msg: Message, t_rx_ns: int) -> Outcome:
    q, rates = _finite(msg, "q1", "q2", "q3", "q4"), _vec3(msg, "rollspeed", "pitchspeed", "yawspeed")
    if q is None or rates is None:
        return Reason.NOT_FINITE
    if not 0.9 < math.hypot(*q) < 1.1:
        return Reason.BAD_INPUT
    return Attitude(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, normalised((q[0], q[1], q[2], q[3])), rates)


def _global_position_int(msg: Message, t_rx_ns: int) -> Outcome:
    if msg.lat == 0 and msg.lon == 0:
        return Reason.NO_ORIGIN
    where = place(msg.lat, msg.lon, msg.alt)
    if where is None:
        return Reason.BAD_INPUT
    v_ned_mps = (msg.vx / 100.0, msg.vy / 100.0, msg.vz / 100.0)
    return PriorPose(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, where, v_ned_mps, msg.relative_alt / 1e3)


def _local_position_ned(msg: Message, t_rx_ns: int) -> Outcome:
    p_ned_m, v_ned_mps = _vec3(msg, "x", "y", "z"), _vec3(msg, "vx", "vy", "vz")
    if p_ned_m is None or v_ned_mps is None:
        return Reason.NOT_FINITE
    return LocalPose(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, p_ned_m, v_ned_mps)


def _ratio(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _ekf_status_report(msg: Message, t_rx_ns: int) -> Outcome:
    """ArduPilot says that its velocity is good in constant position mode, too, where it is none; without any flag it says nothing
    (a simulator of 2018 that flies on DCM)."""
    constant = bool(msg.flags & mav.EKF_CONST_POS_MODE)
    return EstimatorStatus(
        t_rx_ns,
        position_ratio=_ratio(msg.pos_horiz_variance),
        velocity_ratio=_ratio(msg.velocity_variance),
        height_ratio=_ratio(msg.pos_vert_variance),
        horizontal_position_ok=bool(msg.flags & mav.EKF_POS_HORIZ_ABS) and not constant,
        gnss_glitch=bool(msg.flags & mav.EKF_GPS_GLITCHING),
        gnss_in_use=None,
        velocity_ok=bool(msg.flags & mav.EKF_VELOCITY_HORIZ) and not constant if msg.flags else None,
    )


def _estimator_status(msg: Message, t_rx_ns: int) -> Outcome:
    """PX4 sets ESTIMATOR_CONST_POS_MODE whenever the vehicle is at rest, too: its position is judged by POS_HORIZ_ABS alone,
    which is unset without aiding (Ekf::get_ekf_soln_status, ekf_helper.cpp)."""
    return EstimatorStatus(
        t_rx_ns,
        position_ratio=_ratio(msg.pos_horiz_ratio),
        velocity_ratio=_ratio(msg.vel_ratio),
        height_ratio=_ratio(msg.pos_vert_ratio),
        horizontal_position_ok=bool(msg.flags & mav.ESTIMATOR_POS_HORIZ_ABS),
        gnss_glitch=bool(msg.flags & mav.ESTIMATOR_GPS_GLITCH),
        gnss_in_use=bool(msg.flags & mav.ESTIMATOR_PRED_POS_HORIZ_ABS),
        aided=bool(msg.flags & mav.ESTIMATOR_PRED_POS_HORIZ_REL),
        velocity_ok=bool(msg.flags & mav.ESTIMATOR_VELOCITY_HORIZ),
    )


def _distance_sensor(msg: Message, t_rx_ns: int) -> Outcome:
    if msg.orientation != mav.MAV_SENSOR_ROTATION_PITCH_270:
        return None
    # Both autopilots cut whole centimetres off: what reads as the end of the reach lies at it or beyond.
    in_range = msg.min_distance <= msg.current_distance < msg.max_distance
    invalid_signal = getattr(msg, "signal_quality", 0) == 1
    sigma_m = math.sqrt(msg.covariance) / 100.0 if 0 < msg.covariance < _UNKNOWN_VARIANCE else None  # cm²
    valid = in_range and not invalid_signal
    return Range(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, msg.current_distance / 100.0, valid, msg.id, sigma_m)


def _rangefinder(msg: Message, t_rx_ns: int) -> Outcome:
    if not math.isfinite(msg.distance):
        return Reason.NOT_FINITE
    return Range(t_rx_ns, 0, float(msg.distance), msg.distance > 0)


def _scaled_pressure(msg: Message, t_rx_ns: int) -> Outcome:
    if not math.isfinite(msg.press_abs):
        return Reason.NOT_FINITE
    dynamic_hpa = float(msg.press_diff) if math.isfinite(msg.press_diff) else 0.0
    return Baro(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, float(msg.press_abs), msg.temperature / 100.0, dynamic_hpa)


def _imu(t_rx_ns: int, t_boot_ns: int, force_frd_mps2: Vec3) -> Outcome:
    if not all(map(math.isfinite, force_frd_mps2)):
        return Reason.NOT_FINITE
    return Imu(t_rx_ns, t_boot_ns, force_frd_mps2) if any(force_frd_mps2) else Reason.BAD_INPUT


def _scaled_imu(msg: Message, t_rx_ns: int) -> Outcome:
    return _imu(t_rx_ns, msg.time_boot_ms * _NS_PER_MS, _from_milli_g(msg))


def _raw_imu(msg: Message, t_rx_ns: int) -> Outcome:
    """ArduPilot fills RAW_IMU with thousandths of g (GCS_Common.cpp, send_raw_imu)."""
    return _imu(t_rx_ns, wrapped_ns(msg.time_usec), _from_milli_g(msg))


def _highres_imu(msg: Message, t_rx_ns: int) -> Outcome:
    return _imu(t_rx_ns, wrapped_ns(msg.time_usec), (float(msg.xacc), float(msg.yacc), float(msg.zacc)))


def _from_milli_g(msg: Message) -> Vec3:
    return msg.xacc * _MILLI_G_MPS2, msg.yacc * _MILLI_G_MPS2, msg.zacc * _MILLI_G_MPS2


def _gps_global_origin(msg: Message, t_rx_ns: int) -> Outcome:
    if msg.latitude == 0 and msg.longitude == 0:
        return Reason.NO_ORIGIN
    origin = place(msg.latitude, msg.longitude, msg.altitude)
    return Reason.BAD_INPUT if origin is None else OriginChanged(t_rx_ns, origin)


def _heartbeat(msg: Message, t_rx_ns: int) -> Outcome:
    if not is_autopilot(msg):
        return None
    armed = bool(msg.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
    return LinkChanged(t_rx_ns, True, autopilot_kind(msg), "", msg.get_srcSystem(), armed)


def autopilot_kind(heartbeat: Message) -> AutopilotKind:
    """What the autopilot of a HEARTBEAT is."""
    return _KINDS.get(heartbeat.autopilot, AutopilotKind.UNKNOWN)


def is_autopilot(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT comes from what flies a vehicle (no ground station, companion, gimbal, camera or tracker)."""
    return heartbeat.autopilot != mav.MAV_AUTOPILOT_INVALID and heartbeat.type not in NO_AUTOPILOT_TYPES


def _autopilot_version(msg: Message, t_rx_ns: int) -> Outcome:
    version = version_text(msg.flight_sw_version)
    return LinkChanged(t_rx_ns, True, version=version, system_id=msg.get_srcSystem()) if version else None


def version_text(flight_sw_version: int) -> str:
    """ "4.7.0-dev" of AUTOPILOT_VERSION.flight_sw_version (major, minor, patch, FIRMWARE_VERSION_TYPE); empty for 0."""
    if flight_sw_version == 0:
        return ""
    major, minor, patch, kind = flight_sw_version.to_bytes(4, "big")
    suffix = next(name for least, name in _VERSION_TYPES if kind >= least)
    return f"{major}.{minor}.{patch}{suffix}"


_HANDLERS: dict[str, Callable[[Message, int], Outcome]] = {
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
    "GLOBAL_POSITION_INT": _global_position_int,
    "LOCAL_POSITION_NED": _local_position_ned,
    codec_gimbal.NAME: codec_gimbal.gimbal_attitude,
    **codec_gnss.HANDLERS,
    "EKF_STATUS_REPORT": _ekf_status_report,
    "ESTIMATOR_STATUS": _estimator_status,
    "DISTANCE_SENSOR": _distance_sensor,
    "RANGEFINDER": _rangefinder,
    "SCALED_PRESSURE": _scaled_pressure,
    "SCALED_IMU": _scaled_imu,
    "RAW_IMU": _raw_imu,
    "HIGHRES_IMU": _highres_imu,
    "GPS_GLOBAL_ORIGIN": _gps_global_origin,
    "HEARTBEAT": _heartbeat,
    "AUTOPILOT_VERSION": _autopilot_version,
}
DECODED = frozenset(_HANDLERS)
"""Names of the messages that `decode` may make an event of."""
