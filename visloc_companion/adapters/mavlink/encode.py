"""Commands to MAVLink 2 messages. Covariances are written as each autopilot reads them.

VISION_POSITION_ESTIMATE.covariance is the upper triangle, row by row, of (x, y, z, roll, pitch, yaw): entries 0, 6, 11 are the
diagonal of position, 15, 18, 20 that of attitude.

* PX4 takes 0, 6, 11 as variances (mavlink_receiver.cpp).
* ArduPilot takes posErr = cbrt(c0^2 + c6^2 + c11^2) and angErr likewise of 15, 18, 20 (GCS_Common.cpp): to make it believe a
  standard deviation s, c0 = c6 = c11 = sqrt(s^3 / 3) is sent. It knows one radius for both axes, so s is the larger semi-axis.

All 21 entries are always finite: a NaN makes ArduPilot fall to its 0.2 m default or raise an internal error, and PX4 drop fixes.
"""

from __future__ import annotations

import math
import struct

from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import AutopilotKind, Cov2, Injection, Notice, Severity

STATUSTEXT_LENGTH = 50
_MIN_SIGMA_M, _MAX_SIGMA_M = 0.01, 1000.0
_MIN_SIGMA_RAD, _MAX_SIGMA_RAD = 1e-3, math.pi
_SEVERITIES = {
    Severity.INFO: mav.MAV_SEVERITY_INFO,
    Severity.NOTICE: mav.MAV_SEVERITY_NOTICE,
    Severity.WARNING: mav.MAV_SEVERITY_WARNING,
    Severity.CRITICAL: mav.MAV_SEVERITY_CRITICAL,
}


def vision_position_estimate(injection: Injection, kind: AutopilotKind) -> Message | Reason:
    """VISION_POSITION_ESTIMATE (102) of an injection, or NOT_FINITE where it holds a number that must not be sent.

    `usec` is `Injection.t_ns` on our monotonic clock, the one that TIMESYNC replies show: one time base for all that we send,
    because ArduPilot keeps one jitter filter for the whole link. `z` is the injection's own (barometric) height.
    """
    numbers = (*injection.p_ned_m, *injection.q_ned_frd, *injection.cov_ne_m2[0], *injection.cov_ne_m2[1])
    if not all(map(math.isfinite, (*numbers, injection.sigma_d_m, injection.sigma_yaw_rad))):
        return Reason.NOT_FINITE
    if max(map(abs, injection.p_ned_m)) > 1e7 or injection.t_ns < 0:
        return Reason.BAD_INPUT
    covariance = ardupilot_covariance(injection) if kind is AutopilotKind.ARDUPILOT else variance_covariance(injection)
    return mav.MAVLink_vision_position_estimate_message(
        max(1, injection.t_ns // 1000),
        *injection.p_ned_m,
        *euler_from_quat(injection.q_ned_frd),
        covariance,
        injection.reset_counter % 256,
    )


def ardupilot_covariance(injection: Injection) -> list[float]:
    """The 21 entries that make ArduPilot's posErr the larger semi-axis of the horizontal covariance (see the module)."""
    position = math.sqrt(_clamp(_larger_sigma(injection.cov_ne_m2), _MIN_SIGMA_M, _MAX_SIGMA_M) ** 3 / 3)
    angle = math.sqrt(_clamp(injection.sigma_yaw_rad, _MIN_SIGMA_RAD, _MAX_SIGMA_RAD) ** 3 / 3)
    return _triangle((position, position, position), 0.0, angle)


def variance_covariance(injection: Injection) -> list[float]:
    """The 21 entries as true variances, as the message's definition says and PX4 reads it.

    Roll and pitch are the autopilot's own and get the variance of yaw, for want of a better one; no autopilot fuses them.
    """
    (nn, ne), (_, ee) = injection.cov_ne_m2
    low, high = _MIN_SIGMA_M**2, _MAX_SIGMA_M**2
    nn, ee = _clamp(nn, low, high), _clamp(ee, low, high)
    bound = 0.999 * math.sqrt(nn * ee)
    dd = _clamp(injection.sigma_d_m, _MIN_SIGMA_M, _MAX_SIGMA_M) ** 2
    yaw = _clamp(injection.sigma_yaw_rad, _MIN_SIGMA_RAD, _MAX_SIGMA_RAD) ** 2
    return _triangle((nn, ee, dd), _clamp(ne, -bound, bound), yaw)


def _triangle(position: tuple[float, float, float], north_east: float, angle: float) -> list[float]:
    entries = [0.0] * 21
    entries[0], entries[6], entries[11] = position
    entries[1] = north_east
    entries[15] = entries[18] = entries[20] = angle
    return entries


def _larger_sigma(cov: Cov2) -> float:
    (nn, ne), (_, ee) = cov
    return math.sqrt(max(0.0, (nn + ee) / 2 + math.hypot((nn - ee) / 2, ne)))


def _clamp(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


def statustext(notice: Notice) -> Message:
    """STATUSTEXT (253), cut to its 50 characters; characters beyond ASCII become '?'."""
    text = notice.text.encode("ascii", errors="replace")[:STATUSTEXT_LENGTH]
    return mav.MAVLink_statustext_message(_SEVERITIES[notice.severity], text)


def command_long(system_id: int, command: int, *params: float, confirmation: int = 0) -> Message:
    """COMMAND_LONG (76) to the autopilot component; unnamed parameters are 0."""
    filled = (*params, *(0.0 for _ in range(7 - len(params))))
    return mav.MAVLink_command_long_message(system_id, 1, command, confirmation, *filled)


def param_set_int32(system_id: int, name: str, value: int) -> Message:
    """PARAM_SET (23) of a 32-bit integer as PX4 wants it: its bytes in the place of the float's, not its value."""
    return mav.MAVLink_param_set_message(system_id, 1, name.encode("ascii"), float_of_int32(value), mav.MAV_PARAM_TYPE_INT32)


def float_of_int32(value: int) -> float:
    """The float whose bytes are those of the integer (exact for all that is not a NaN's pattern)."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def int32_of_float(value: float) -> int:
    """The integer whose bytes are those of the float."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
