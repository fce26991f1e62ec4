"""Covariances as autopilots read them. The 21 entries are the upper triangle, row by row, of (x, y, z, roll, pitch, yaw), or of
the rates of these: entries 0, 6, 11 are the diagonal of the first three, 15, 18, 20 that of the last three.

* PX4 takes 0, 6, 11 as variances (mavlink_receiver.cpp).
* ArduPilot takes posErr = cbrt(c0^2 + c6^2 + c11^2) and angErr likewise of 15, 18, 20 (GCS_Common.cpp): to make it believe a
  standard deviation s, c0 = c6 = c11 = sqrt(s^3 / 3) is sent. It knows one radius for both axes, so s is the larger semi-axis.

All 21 entries are always finite, and no variance is ever below that of MIN_SIGMA_M: a NaN makes ArduPilot fall to its 0.2 m
default or raise an internal error, and PX4 drop fixes.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.core.covariance import floored, largest_sigma_m
from visloc_companion.types import AutopilotKind, Cov2, Injection

MIN_SIGMA_M, MAX_SIGMA_M = 0.01, 1000.0
_MIN_SIGMA_RAD, _MAX_SIGMA_RAD = 1e-3, math.pi
VERTICAL_SIGMA_MPS = 10.0
"""1-sigma of a vertical velocity that is the autopilot's own: what comes back to it must teach it nothing."""
UNKNOWN_RATE_SIGMA_RADPS = 10.0


def pose_triangle(injection: Injection, kind: AutopilotKind) -> list[float]:
    """The 21 entries of the pose for an autopilot, whose filter takes each position for news (`Injection.stream_sigma_m`)."""
    if injection.stream_sigma_m > 0:
        injection = replace(injection, cov_ne_m2=floored(injection.cov_ne_m2, injection.stream_sigma_m))
    return ardupilot_triangle(injection) if kind is AutopilotKind.ARDUPILOT else variance_triangle(injection)


def ardupilot_triangle(injection: Injection) -> list[float]:
    """The 21 entries that make ArduPilot's posErr the larger semi-axis of the horizontal covariance (see the module)."""
    position = math.sqrt(sigma_m(injection.cov_ne_m2) ** 3 / 3)
    angle = math.sqrt(_clamp(injection.sigma_yaw_rad, _MIN_SIGMA_RAD, _MAX_SIGMA_RAD) ** 3 / 3)
    return _triangle((position, position, position), 0.0, angle)


def variance_triangle(injection: Injection) -> list[float]:
    """The 21 entries as true variances, as the message's definition says and PX4 reads it.

    Roll and pitch are the autopilot's own and get the variance of yaw, for want of a better one; no autopilot fuses them.
    """
    nn, ne, ee = _sane(injection.cov_ne_m2)
    dd = vertical_sigma_m(injection) ** 2
    yaw = _clamp(injection.sigma_yaw_rad, _MIN_SIGMA_RAD, _MAX_SIGMA_RAD) ** 2
    return _triangle((nn, ee, dd), ne, yaw)


def velocity_triangle(cov_v_ne_m2ps2: Cov2) -> list[float]:
    """The 21 entries of a velocity in NED, as variances; the body's rates are not known."""
    nn, ne, ee = _sane(cov_v_ne_m2ps2)
    return _triangle((nn, ee, VERTICAL_SIGMA_MPS**2), ne, UNKNOWN_RATE_SIGMA_RADPS**2)


def sigma_m(cov: Cov2) -> float:
    """The larger semi-axis of a horizontal covariance, within the bounds of what is sent (m, or m/s for a velocity)."""
    return _clamp(largest_sigma_m(cov), MIN_SIGMA_M, MAX_SIGMA_M)


def vertical_sigma_m(injection: Injection) -> float:
    """1-sigma of the height, within the bounds of what is sent."""
    return _clamp(injection.sigma_d_m, MIN_SIGMA_M, MAX_SIGMA_M)


def _sane(cov: Cov2) -> tuple[float, float, float]:
    (nn, ne), (_, ee) = cov
    low, high = MIN_SIGMA_M**2, MAX_SIGMA_M**2
    nn, ee = _clamp(nn, low, high), _clamp(ee, low, high)
    bound = 0.999 * math.sqrt(nn * ee)
    return nn, 0.0 if math.isnan(ne) else _clamp(ne, -bound, bound), ee


def _triangle(diagonal: tuple[float, float, float], north_east: float, angle: float) -> list[float]:
    entries = [0.0] * 21
    entries[0], entries[6], entries[11] = diagonal
    entries[1] = north_east
    entries[15] = entries[18] = entries[20] = angle
    return entries


def _clamp(value: float, low: float, high: float) -> float:
    """Within bounds; what is not a number claims nothing, which is the upper one."""
    return high if math.isnan(value) else min(high, max(low, value))
