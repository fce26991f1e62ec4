"""Sanity of what comes in from outside: NaN, absurd places and covariances never reach the filter."""

from __future__ import annotations

import math

from visloc_companion.errors import Reason
from visloc_companion.types import (
    Attitude,
    Baro,
    Cov2,
    EstimatorStatus,
    Event,
    Fix,
    FrameRef,
    GeoPoint,
    GimbalAttitude,
    Gnss,
    GnssTime,
    Imu,
    LinkChanged,
    LocalPose,
    MapAtGnss,
    NoFix,
    Odometry,
    OperatorFix,
    OriginChanged,
    PriorPose,
    Range,
    Tick,
    TiltSeen,
    TimesyncSample,
    Turn,
    WorkerState,
)

NOTHING_TO_CHECK = frozenset({Tick, TimesyncSample, GnssTime, LinkChanged, WorkerState})
MAX_SPEED_MPS = 200.0
MAX_HEIGHT_M, MAX_LOCAL_M = 50_000.0, 1e6
MAX_FORCE_MPS2 = 160.0
"""What accelerometers of autopilots can measure."""
MAX_OPERATOR_SIGMA_M = 10_000.0
MAX_LATITUDE_DEG = 89.0
"""Beyond, north turns by more than a degree within 2 km."""
MIN_SIGMA_M, MAX_SIGMA_M = 1e-3, 1e5
MAX_LEAD_NS = 200_000_000
"""Times of validity may lie this far ahead of the shell's clock (clock offsets are estimates)."""


def fault(event: Event, now_ns: int) -> Reason | None:  # noqa: PLR0911, PLR0912 (one return for each kind of event)
    """Why an event must not be used, or None. Fields that autopilots may leave unknown (None) are fine."""
    if type(event) in NOTHING_TO_CHECK:
        return None
    match event:
        case Attitude():
            return _unless(_finite(*event.q_ned_frd, *event.rate_frd_radps))
        case GimbalAttitude():
            return _unless(_finite(*event.q_frame_gimbal) and abs(math.hypot(*event.q_frame_gimbal) - 1.0) < 1e-3)
        case PriorPose():
            fine = _is_velocity(event.v_ned_mps) and _is_height(event.h_rel_m)
            return _place_fault(event.place) if fine else Reason.NOT_FINITE
        case LocalPose():
            near = _finite(*event.p_ned_m) and math.hypot(*event.p_ned_m[:2]) <= MAX_LOCAL_M
            return _unless(near and _is_height(event.p_ned_m[2]) and _is_velocity(event.v_ned_mps))
        case Gnss():
            known = [v for v in (event.h_acc_m, event.v_acc_m, *(event.v_ned_mps or ())) if v is not None]
            place = (event.place.lat_deg, event.place.lon_deg, event.place.h_amsl_m)
            return _unless(_finite(*place, *known))  # receivers without a fix report any place
        case MapAtGnss():
            return _unless(_finite(event.place.h_amsl_m, event.surface_amsl_m or 0.0))
        case EstimatorStatus():
            ratios = (event.position_ratio, event.velocity_ratio, event.height_ratio)
            return _unless(_finite(*(r for r in ratios if r is not None)))
        case Imu():
            return _unless(_finite(*event.force_frd_mps2) and max(map(abs, event.force_frd_mps2)) <= MAX_FORCE_MPS2)
        case Baro():
            return _unless(_finite(event.pressure_hpa, event.dynamic_hpa))
        case Range():
            return _unless(_finite(event.distance_m, event.sigma_m or 0.0))
        case OriginChanged():
            return _place_fault(event.origin)
        case OperatorFix():
            fine = _finite(event.sigma_m) and 0 < event.sigma_m <= MAX_OPERATOR_SIGMA_M
            return _place_fault(event.place) if fine else Reason.NOT_FINITE
        case Fix():
            return _fix_fault(event, now_ns)
        case NoFix():
            return _no_fix_fault(event) or (None if event.zoomed is None else _fix_fault(event.zoomed, now_ns))
        case Odometry():
            return _odometry_fault(event, now_ns)
        case FrameRef():
            return Reason.IMPLAUSIBLE_TIME if event.t_ns > now_ns + MAX_LEAD_NS else None
        case _:
            return None


def _fix_fault(fix: Fix, now_ns: int) -> Reason | None:
    if fix.t_ns > now_ns + MAX_LEAD_NS:
        return Reason.IMPLAUSIBLE_TIME
    sigmas = (*fix.cov_ne_m2[0], *fix.cov_ne_m2[1], fix.sigma_h_m)
    ground = fix.above_ground_m or 0.0, fix.footprint_m or 0.0
    seen = (*ground, *(() if fix.sun is None else (fix.sun.azimuth_deg, fix.sun.elevation_deg)))
    numbers = _finite(*fix.q_ned_frd, *sigmas, fix.sigma_yaw_rad, fix.probability_wrong, *fix.per_focal_ne_m, *seen)
    turned = _turns_are_sound(fix) and (fix.tilt is None or is_tilt(fix.tilt))
    if not (numbers and turned and is_place(fix.place)):
        return Reason.NOT_FINITE
    claims = MIN_SIGMA_M <= fix.sigma_h_m <= MAX_SIGMA_M and is_covariance(fix.cov_ne_m2)
    claims = claims and (fix.footprint_m is None or fix.footprint_m > 0)
    return None if claims else Reason.IMPLAUSIBLE_CLAIM


def _turns_are_sound(answer: Fix | NoFix) -> bool:
    return all(turn is None or is_turn(turn) for turn in (answer.turn, answer.turn_since_kept))


def _no_fix_fault(answer: NoFix) -> Reason | None:
    places = answer.open_places
    numbers = _finite(answer.footprint_m or 0.0, *(p.log_evidence for p in places)) and all(is_place(p.place) for p in places)
    if not (numbers and _turns_are_sound(answer)):
        return Reason.NOT_FINITE
    claims = all(p.log_evidence <= 0 and is_covariance(p.cov_ne_m2) for p in places)
    return None if claims and (answer.footprint_m is None or answer.footprint_m > 0) else Reason.IMPLAUSIBLE_CLAIM


def _odometry_fault(seen: Odometry, now_ns: int) -> Reason | None:
    if seen.t_to_ns > now_ns + MAX_LEAD_NS or seen.t_from_ns >= seen.t_to_ns:
        return Reason.IMPLAUSIBLE_TIME
    shared = (seen.sigma_scale, seen.sigma_heading_rad, seen.sigma_focal)
    numbers = _finite(*seen.displacement_ned_m, *shared, *seen.per_focal_ne_m)
    return _unless(numbers and is_covariance(seen.cov_ne_m2))


def _unless(fine: bool) -> Reason | None:
    return None if fine else Reason.NOT_FINITE


def _place_fault(place: GeoPoint) -> Reason | None:
    """One that is no place, or one at a pole, which is."""
    if is_place(place):
        return None
    at_a_pole = MAX_LATITUDE_DEG < abs(place.lat_deg) <= 90 and _finite(place.lon_deg) and _is_height(place.h_amsl_m)
    return Reason.AT_A_POLE if at_a_pole else Reason.NOT_FINITE


def is_place(place: GeoPoint) -> bool:
    """Finite, on the globe but for its poles, and not the 0, 0 that autopilots send for "unknown"."""
    if not _finite(place.lat_deg, place.lon_deg, place.h_amsl_m):
        return False
    on_globe = abs(place.lat_deg) <= MAX_LATITUDE_DEG and abs(place.lon_deg) <= 180 and _is_height(place.h_amsl_m)
    return on_globe and not (place.lat_deg == 0 and place.lon_deg == 0)


def is_covariance(cov_m2: Cov2) -> bool:
    """Finite, symmetric, positive definite, between 1 mm and 100 km."""
    (nn, _), (_, ee) = cov_m2
    return _is_positive_definite(cov_m2) and min(nn, ee) >= MIN_SIGMA_M**2 and max(nn, ee) <= MAX_SIGMA_M**2


def is_tilt(tilt: TiltSeen) -> bool:
    """Finite, and with a covariance that is symmetric and positive definite."""
    return _finite(*tilt.turn_ne_rad) and _is_positive_definite(tilt.cov_rad2)


def _is_positive_definite(cov: Cov2) -> bool:
    """Finite and symmetric, too."""
    (nn, ne), (en, ee) = cov
    if not _finite(nn, ne, en, ee) or abs(ne - en) > 1e-9 * (nn + ee):
        return False
    return min(nn, ee) > 0 and nn * ee - ne * en > 1e-9 * nn * ee


def is_turn(turn: Turn) -> bool:
    """Finite, a rotation, forward in time, and with a covariance whose diagonal is positive and dominates."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn.cov_rad2
    if not _finite(*turn.q_from_to, xx, xy, xz, yx, yy, yz, zx, zy, zz) or turn.t_from_ns >= turn.t_to_ns:
        return False
    pairs = ((xy, yx, xx * yy), (xz, zx, xx * zz), (yz, zy, yy * zz))
    fine = min(xx, yy, zz) > 0 and all(a == b and a * b < limit for a, b, limit in pairs)
    return fine and abs(math.hypot(*turn.q_from_to) - 1.0) < 1e-3


def _is_velocity(v_mps: tuple[float, float, float]) -> bool:
    return _finite(*v_mps) and max(map(abs, v_mps)) <= MAX_SPEED_MPS


def _is_height(h_m: float) -> bool:
    return abs(h_m) <= MAX_HEIGHT_M  # not where it is none


def _finite(*numbers: float) -> bool:
    return math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))  # finite numbers may have no finite sum
