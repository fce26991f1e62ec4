"""Places on the WGS 84 ellipsoid and local coordinates about an origin.

`ned` is curvilinear: north and east are arc lengths along the meridian and the parallel with the ellipsoid's radii of
curvature (taken at the mean latitude), down is the height difference. For vehicles within some tens of kilometres of the
origin this is exact to centimetres, and heights stay heights. The autopilots use spherical formulae instead, which differ by
up to 0.4 % of the distance; what is exchanged with them as local coordinates goes through `autopilot_ned_*`.
"""

from __future__ import annotations

import math

from visloc_companion.types import AutopilotKind, GeoPoint, Vec3

SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_2 = 6.69437999014e-3
_OF_MERIDIAN_M = SEMI_MAJOR_M * (1 - ECCENTRICITY_2)
ARDUPILOT_M_PER_DEG = 0.011131884502145034 * 1e7
"""ArduPilot's LOCATION_SCALING_FACTOR (libraries/AP_Common/Location.h), per degree."""
PX4_RADIUS_M = 6371000.0
"""PX4's CONSTANTS_RADIUS_OF_EARTH (src/lib/geo/geo.h)."""


def radii_m(lat_deg: float) -> tuple[float, float]:
    """Radii of curvature at a latitude: meridian and prime vertical, metres."""
    w2 = _w2(lat_deg)
    return _meridian_m(w2), SEMI_MAJOR_M / math.sqrt(w2)


def _meridian_m(w2: float) -> float:
    return float(_OF_MERIDIAN_M / w2**1.5)


def _w2(lat_deg: float) -> float:
    return 1 - ECCENTRICITY_2 * math.sin(math.radians(lat_deg)) ** 2


def _lon_difference_deg(lon_deg: float, lon0_deg: float) -> float:
    return (lon_deg - lon0_deg + 180) % 360 - 180


def ned_from_geo(place: GeoPoint, origin: GeoPoint) -> Vec3:
    """North, east, down (m) of a place about an origin."""
    mid = (place.lat_deg + origin.lat_deg) / 2
    meridian, normal = radii_m(mid)
    north = math.radians(place.lat_deg - origin.lat_deg) * meridian
    east = math.radians(_lon_difference_deg(place.lon_deg, origin.lon_deg)) * normal * math.cos(math.radians(mid))
    return north, east, origin.h_amsl_m - place.h_amsl_m


def geo_from_ned(p_ned_m: Vec3, origin: GeoPoint) -> GeoPoint:
    """The inverse of `ned_from_geo`."""
    lat0 = lat = origin.lat_deg
    for _ in range(3):
        lat = lat0 + math.degrees(p_ned_m[0] / _meridian_m(_w2((lat + lat0) / 2)))
    mid = (lat + lat0) / 2
    lon = origin.lon_deg + math.degrees(p_ned_m[1] / (radii_m(mid)[1] * math.cos(math.radians(mid))))
    return GeoPoint(lat, (lon + 180) % 360 - 180, origin.h_amsl_m - p_ned_m[2])


def autopilot_ned_from_geo(kind: AutopilotKind, place: GeoPoint, origin: GeoPoint) -> Vec3:
    """North, east, down as the autopilot itself computes them.

    ArduPilot: Location::get_distance_NE (equirectangular, cosine at the mean latitude). PX4 and unknown:
    MapProjection::project (azimuthal equidistant on a sphere).
    """
    down = origin.h_amsl_m - place.h_amsl_m
    if kind is AutopilotKind.ARDUPILOT:
        mid = math.radians((place.lat_deg + origin.lat_deg) / 2)
        east = _lon_difference_deg(place.lon_deg, origin.lon_deg) * ARDUPILOT_M_PER_DEG * max(math.cos(mid), 0.01)
        return (place.lat_deg - origin.lat_deg) * ARDUPILOT_M_PER_DEG, east, down
    lat, lat0 = math.radians(place.lat_deg), math.radians(origin.lat_deg)
    dlon = math.radians(_lon_difference_deg(place.lon_deg, origin.lon_deg))
    cos_c = math.sin(lat0) * math.sin(lat) + math.cos(lat0) * math.cos(lat) * math.cos(dlon)
    c = math.acos(max(-1.0, min(1.0, cos_c)))
    k = PX4_RADIUS_M * (c / math.sin(c) if c > 1e-9 else 1.0)
    north = k * (math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(dlon))
    return north, k * math.cos(lat) * math.sin(dlon), down


def geo_from_autopilot_ned(kind: AutopilotKind, p_ned_m: Vec3, origin: GeoPoint) -> GeoPoint:
    """The inverse of `autopilot_ned_from_geo`, to better than a millimetre (fixed-point iteration)."""
    guess = geo_from_ned(p_ned_m, origin)
    for _ in range(4):
        got = autopilot_ned_from_geo(kind, guess, origin)
        meridian, normal = radii_m(guess.lat_deg)
        lat = guess.lat_deg + math.degrees((p_ned_m[0] - got[0]) / meridian)
        lon = guess.lon_deg + math.degrees((p_ned_m[1] - got[1]) / (normal * math.cos(math.radians(guess.lat_deg))))
        guess = GeoPoint(lat, (lon + 180) % 360 - 180, guess.h_amsl_m)
    return guess


def same_spot(a: GeoPoint | None, b: GeoPoint | None) -> bool:
    """Whether two places have one latitude and longitude, whatever their heights. None is nowhere."""
    return a is not None and b is not None and (a.lat_deg, a.lon_deg) == (b.lat_deg, b.lon_deg)


def distance_m(a: GeoPoint, b: GeoPoint) -> float:
    """Horizontal distance of two places near each other, metres."""
    north, east, _ = ned_from_geo(a, b)
    return math.hypot(north, east)
