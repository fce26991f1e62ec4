"""What the operator says of the vehicle's place, held against what is known: it is a place to look at, and no more than that.

Whoever is on the link can say it. So it never moves a position that fixes or a trusted GNSS hold, and where it starts the filter,
nothing is injected before a localiser has found the vehicle there.
"""

from __future__ import annotations

import math

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NavState, OperatorFix

REACH_M = 100_000.0
MARGIN_M = 50.0
"""For a vehicle that moves on while the operator speaks, and for the origin of the map."""
SIGMAS = 4.0


def objection(said: OperatorFix, origin: GeoPoint | None, receiver: GeoPoint | None, held: NavState | None) -> str | None:
    """Why it is refused, None where it is not. `receiver`: the place of a GNSS that is trusted; `held`: the state now, where
    fixes or a trusted GNSS hold it."""
    if origin is None:
        return "no EKF origin yet"
    if wgs84.distance_m(said.place, origin) > REACH_M:
        return "too far from origin"
    far_m = SIGMAS * said.sigma_m + MARGIN_M
    if receiver is not None and wgs84.distance_m(said.place, receiver) > far_m:
        return "far from trusted GNSS"
    if held is None:
        return None
    place = wgs84.geo_from_ned((*held.p_ned_m[:2], 0.0), origin)
    far_m += SIGMAS * largest_sigma_m(held.cov_ne_m2)
    return "far from the fixes" if wgs84.distance_m(said.place, place) > far_m else None


def elsewhere(said: OperatorFix, fix: Fix, held: NavState | None, origin: GeoPoint | None) -> bool:
    """Whether a fix is not of where the operator said; `held`: the state at its time without it, which began there."""
    if held is None or origin is None:
        return False
    north, east, _ = wgs84.ned_from_geo(fix.place, origin)
    return math.dist((north, east), held.p_ned_m[:2]) > SIGMAS * said.sigma_m + MARGIN_M
