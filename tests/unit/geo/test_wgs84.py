import math
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod

from visloc_companion.geo.wgs84 import (
    autopilot_ned_from_geo,
    distance_m,
    geo_from_autopilot_ned,
    geo_from_ned,
    ned_from_geo,
    radii_m,
    same_spot,
)
from visloc_companion.types import AutopilotKind, GeoPoint

GEOD = Geod(ellps="WGS84")
places = st.builds(GeoPoint, st.floats(-80, 80), st.floats(-180, 180), st.floats(-100, 5000))
steps = st.tuples(st.floats(-20e3, 20e3), st.floats(-20e3, 20e3), st.floats(-500, 500))


def test_radii_at_equator_and_pole() -> None:
    assert radii_m(0.0) == pytest.approx((6335439.327, 6378137.0), abs=1e-2)
    assert radii_m(90.0) == pytest.approx((6399593.626, 6399593.626), abs=1e-2)


@pytest.mark.parametrize("lat", [-70.0, -20.0, 0.0, 47.0, 65.0])
def test_distance_is_the_geodesic(lat: float) -> None:
    for azimuth, distance in product((0.0, 37.0, 90.0, 200.0, 300.0), (1.0, 500.0, 5000.0)):
        check_geodesic(lat, azimuth, distance)


def check_geodesic(lat: float, azimuth: float, distance: float) -> None:
    lon2, lat2, _ = GEOD.fwd(25.0, lat, azimuth, distance)
    here, there = GeoPoint(lat, 25.0, 100.0), GeoPoint(lat2, lon2, 80.0)
    assert distance_m(there, here) == pytest.approx(distance, rel=5e-7, abs=1e-6)
    north, east, down = ned_from_geo(there, here)
    assert down == 20.0
    if distance < 1000:
        assert (north, east) == pytest.approx(
            (distance * math.cos(math.radians(azimuth)), distance * math.sin(math.radians(azimuth))), abs=2e-4 * distance
        )


@settings(max_examples=40)
@given(places, steps)
def test_ned_there_and_back(origin: GeoPoint, p_ned_m) -> None:
    assert ned_from_geo(geo_from_ned(p_ned_m, origin), origin) == pytest.approx(p_ned_m, abs=1e-4)


def test_date_line_is_no_edge() -> None:
    west, east = GeoPoint(10.0, 179.999, 0.0), GeoPoint(10.0, -179.999, 0.0)
    assert ned_from_geo(east, west)[1] == pytest.approx(219.3, abs=0.1)
    assert geo_from_ned((0.0, 300.0, 0.0), west).lon_deg < -179.99
    assert autopilot_ned_from_geo(AutopilotKind.ARDUPILOT, east, west)[1] == pytest.approx(219.3, abs=0.5)


def test_ardupilot_formula() -> None:
    """Location::get_distance_NE: 1e-7 degrees are 0.011131884502145034 m, longitude times the cosine of the mean latitude."""
    origin, place = GeoPoint(-35.363, 149.165, 584.0), GeoPoint(-35.353, 149.185, 600.0)
    north, east, down = autopilot_ned_from_geo(AutopilotKind.ARDUPILOT, place, origin)
    assert north == pytest.approx(0.010 * 111318.84502145034)
    assert east == pytest.approx(0.020 * 111318.84502145034 * math.cos(math.radians(-35.358)))
    assert down == -16.0


def test_px4_formula() -> None:
    """MapProjection::project on a sphere of 6371000 m: along the meridian and at the origin it is simply the arc."""
    origin = GeoPoint(47.4, 8.5, 488.0)
    north, east, _ = autopilot_ned_from_geo(AutopilotKind.PX4, GeoPoint(47.41, 8.5, 488.0), origin)
    assert (north, east) == pytest.approx((math.radians(0.01) * 6371000, 0.0), abs=1e-6)
    assert autopilot_ned_from_geo(AutopilotKind.PX4, origin, origin) == (0.0, 0.0, 0.0)
    east = autopilot_ned_from_geo(AutopilotKind.UNKNOWN, GeoPoint(47.4, 8.51, 488.0), origin)[1]
    assert east == pytest.approx(math.radians(0.01) * 6371000 * math.cos(math.radians(47.4)), rel=1e-6)


@pytest.mark.parametrize("kind", list(AutopilotKind))
@settings(max_examples=40)
@given(origin=places, p_ned_m=steps)
def test_autopilot_coordinates_there_and_back(kind: AutopilotKind, origin: GeoPoint, p_ned_m) -> None:
    place = geo_from_autopilot_ned(kind, p_ned_m, origin)
    assert autopilot_ned_from_geo(kind, place, origin) == pytest.approx(p_ned_m, abs=1e-3)


def test_autopilots_differ_from_the_ellipsoid_by_less_than_half_a_percent() -> None:
    origin = GeoPoint(47.4, 8.5, 488.0)
    place = geo_from_ned((3000.0, -4000.0, 0.0), origin)
    for kind in (AutopilotKind.ARDUPILOT, AutopilotKind.PX4):
        north, east, _ = autopilot_ned_from_geo(kind, place, origin)
        off = math.hypot(north - 3000, east + 4000)
        assert 1.0 < off < 25.0


def test_one_spot_whatever_the_height_and_none_is_nowhere() -> None:
    here = GeoPoint(47.0, 8.0, 400.0)
    assert same_spot(here, GeoPoint(47.0, 8.0, 900.0))
    assert not same_spot(here, GeoPoint(47.0, 8.0000001, 400.0))
    assert not same_spot(here, None)
    assert not same_spot(None, None)
