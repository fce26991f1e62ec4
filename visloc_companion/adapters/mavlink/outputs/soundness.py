"""Whether the numbers of an injection may be sent at all: finite, on the globe, and with covariances that are covariances."""

from __future__ import annotations

import math

from visloc_companion.adapters.mavlink.outputs.covariance import MAX_SIGMA_M
from visloc_companion.errors import Reason
from visloc_companion.types import Cov2, Injection

MAX_LOCAL_M, MAX_HEIGHT_M, MAX_SPEED_MPS = 1e6, 50_000.0, 200.0


def fault(injection: Injection) -> Reason | None:
    """NOT_FINITE or BAD_INPUT where a number must not be sent."""
    (nn, ne), (en, ee) = injection.cov_ne_m2
    numbers = (*injection.p_ned_m, *injection.q_ned_frd, nn, ne, en, ee, injection.sigma_d_m, injection.sigma_yaw_rad)
    place, velocity, cov_v = injection.place, injection.v_ned_mps, injection.cov_v_ne_m2ps2
    more = (injection.stream_sigma_m, *(velocity or ()), *(cov_v[0] + cov_v[1] if cov_v is not None else ()))
    if not all(map(math.isfinite, (*numbers, place.lat_deg, place.lon_deg, place.h_amsl_m, *more))):
        return Reason.NOT_FINITE
    on_globe = abs(place.lat_deg) <= 90 and abs(place.lon_deg) <= 180 and abs(place.h_amsl_m) <= MAX_HEIGHT_M
    near = max(map(abs, injection.p_ned_m)) <= MAX_LOCAL_M
    turned = 0.99 < math.hypot(*injection.q_ned_frd) < 1.01
    sigmas = 0 < injection.sigma_d_m <= MAX_SIGMA_M and 0 < injection.sigma_yaw_rad <= 2 * math.pi
    sigmas = sigmas and 0 <= injection.stream_sigma_m <= MAX_SIGMA_M
    slow = velocity is None or max(map(abs, velocity)) <= MAX_SPEED_MPS
    sure = _is_covariance(injection.cov_ne_m2) and (cov_v is None or _is_covariance(cov_v))
    fine = on_globe and near and turned and sigmas and slow and sure and injection.t_ns >= 0
    return None if fine else Reason.BAD_INPUT


def _is_covariance(cov: Cov2) -> bool:
    (nn, ne), (en, ee) = cov
    symmetric = abs(ne - en) <= 1e-9 * (abs(nn) + abs(ee))
    return symmetric and 0 < nn <= MAX_SIGMA_M**2 and 0 < ee <= MAX_SIGMA_M**2 and ne * en <= nn * ee * (1 + 1e-9)
