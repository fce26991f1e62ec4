import math
import re
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from visloc_companion.errors import DatumMissing, MapError, OutsideMap
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.maps.crs import HELD_FOR_WGS84_M, NO_BETTER_M, map_crs, utm_at
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.registration import registration_warnings
from visloc_companion.prepare.build import build_pack
from visloc_companion.types import GeoPoint

PLACES = [
    ("EPSG:32612", 40.5, -112.9),
    ("EPSG:32719", -23.3, -67.1),
    ("EPSG:4326", 61.2, 25.1),
    ("EPSG:3857", 48.0, 9.0),
    ("EPSG:2193", -41.3, 174.8),
    ("EPSG:2227", 37.5, -122.0),
    ("EPSG:3035", 63.0, 27.0),
]
NORTH_AMERICA = [(44.0, -121.0), (32.7, -117.1), (25.8, -80.2), (47.6, -52.7), (82.5, -62.3), (71.3, -156.8), (52.8, -173.2)]


@pytest.mark.parametrize(("text", "lat", "lon"), PLACES)
def test_jacobian_predicts_where_a_step_on_the_ground_leads(text: str, lat: float, lon: float) -> None:
    crs, place = map_crs(text), GeoPoint(lat, lon, 0.0)
    here = crs.linearised_at(place)
    for north, east in ((30.0, 0.0), (0.0, 30.0), (-20.0, 25.0)):
        there, back = geo_from_ned((north, east, 0.0), place), geo_from_ned((-north, -east, 0.0), place)
        moved = (np.array(crs.to_map(there.lat_deg, there.lon_deg)) - crs.to_map(back.lat_deg, back.lon_deg)) / 2
        off = here.J_map_ne @ [north, east] - moved
        assert np.linalg.norm(off) < 1e-5 * np.linalg.norm(moved)


@pytest.mark.parametrize("text", ["EPSG:3857", "EPSG:3395", "EPSG:6933", "ESRI:54009"])
def test_beside_its_seam_a_crs_is_as_it_is_elsewhere(text: str) -> None:
    """At the antimeridian the eastings of most world-wide projections jump by 40,000 km."""
    crs = map_crs(text)
    for side in (-1, 1):
        off_seam = crs.linearised_at(GeoPoint(-17.0, side * 179.999, 0.0)).J_map_ne
        for lon in (179.99995, 179.999999, 180.0):
            here = crs.linearised_at(GeoPoint(-17.0, side * lon, 0.0))
            np.testing.assert_allclose(here.J_map_ne, off_seam, rtol=1e-5, atol=1e-6)
            at_map = crs.linearised_at_map(*here.origin_map_m)
            np.testing.assert_allclose(at_map.J_map_ne, here.J_map_ne, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("text", "lat", "lon"), PLACES)
def test_there_and_back(text: str, lat: float, lon: float) -> None:
    crs = map_crs(text)
    assert crs.to_geo(*crs.to_map(lat, lon)) == pytest.approx((lat, lon), abs=1e-8)
    assert crs.to_geo_array(crs.to_map_array(np.array([[lat, lon]])))[0] == pytest.approx((lat, lon), abs=1e-8)


def test_convergence_and_scale_of_utm() -> None:
    central = map_crs("EPSG:32633").linearised_at(GeoPoint(47.0, 15.0, 0.0))
    assert central.convergence_rad == pytest.approx(0.0, abs=1e-9)
    assert central.scale == pytest.approx(0.9996, abs=1e-6)
    east = map_crs("EPSG:32633").linearised_at(GeoPoint(47.0, 17.0, 0.0))
    tan = math.tan(math.radians(2.0)) * math.sin(math.radians(47.0))
    assert east.convergence_rad == pytest.approx(math.atan(tan), abs=2e-5), (
        "east of the meridian grid north lies east of true north"
    )
    south = map_crs("EPSG:32733").linearised_at(GeoPoint(-47.0, 17.0, 0.0))
    assert south.convergence_rad == pytest.approx(-math.atan(tan), abs=2e-5)


def test_properties() -> None:
    feet, degrees = map_crs("EPSG:2227"), map_crs("EPSG:4326")
    assert feet.metres_per_unit == pytest.approx(0.3048006)
    assert math.isnan(degrees.metres_per_unit)
    assert degrees.is_geographic and not feet.is_geographic
    assert (feet.epsg, map_crs(feet.wkt).epsg) == (2227, 2227)
    assert map_crs(feet.wkt) == feet != degrees and hash(map_crs(feet.wkt)) == hash(feet)
    assert feet != "EPSG:2227"
    assert map_crs("EPSG:4979").is_ellipsoidal_3d and not degrees.is_ellipsoidal_3d


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"])
@pytest.mark.parametrize(
    ("epsg", "projection", "place", "accuracy_m"),
    [
        (4490, "+proj=longlat", (30.6, 114.3), 1.0),
        (4547, "+proj=tmerc +lon_0=114 +x_0=500000", (30.6, 114.3), 1.0),
        (4526, "+proj=tmerc +lon_0=114 +x_0=38500000", (30.6, 114.3), 1.0),
        (10732, "+proj=utm +zone=32", (51.2, 9.9), 1.0),
        (6783, "+proj=longlat", (44.0, -121.0), 2.0),
        (22317, "+proj=utm +zone=17", (43.7, -79.4), 2.0),
        (6634, "+proj=utm +zone=4", (21.3, -157.9), 5.0),
    ],
)
def test_what_no_table_relates_to_wgs_84_is_held_for_it_where_it_is_that(
    version: str, epsg: int, projection: str, place: tuple[float, float], accuracy_m: float
) -> None:
    """CGCS2000, in degrees, about 114 degrees east and in zone 38, ETRS89 in Germany under its newer name, and NAD83 as of
    CORS96, CSRS v3 (Ontario) and PA11 (Hawaii)."""
    crs, of_wgs84 = map_crs(CRS.from_epsg(epsg).to_wkt(version)), map_crs(f"{projection} +datum=WGS84")
    assert crs.to_map(*place) == pytest.approx(of_wgs84.to_map(*place), abs=1e-3)
    assert crs.to_geo(*crs.to_map(*place)) == pytest.approx(place, abs=1e-9)
    assert crs.accuracy_m(*crs.to_map(*place)) == accuracy_m


@pytest.mark.parametrize(
    ("epsg", "itrf", "nad83", "places"),
    [
        (6783, 7909, 6782, NORTH_AMERICA),
        (8237, 7907, 8235, NORTH_AMERICA),
        (8240, 7908, 8239, NORTH_AMERICA),
        (8246, 7909, 8244, NORTH_AMERICA),
        (8249, 7910, 8248, NORTH_AMERICA),
        (6325, 7911, 6324, [(13.4, 144.8), (15.2, 145.7), (7.5, 134.6), (18.1, 145.8)]),
        (6322, 7911, 6321, [(19.7, -155.1), (22.0, -159.5), (28.2, -177.4), (-14.3, -170.7), (7.1, 171.2)]),
    ],
)
def test_nad83_lies_beside_the_itrf_by_what_is_stated(
    epsg: int, itrf: int, nad83: int, places: list[tuple[float, float]]
) -> None:
    """Up to 2027; WGS 84 is the ITRF to centimetres. CSRS without a version is any of them."""
    related = Transformer.from_crs(itrf, nad83, always_xy=True, allow_ballpark=False)
    off_m = []
    for lat, lon in places:
        there_lon, there_lat, _, _ = related.transform(lon, lat, 0.0, 2027.0)
        off_m.append(distance_m(GeoPoint(lat, lon, 0.0), GeoPoint(there_lat, there_lon, 0.0)))
    assert 0.7 * HELD_FOR_WGS84_M[epsg] < max(off_m) < HELD_FOR_WGS84_M[epsg]
    assert max(off_m) < NO_BETTER_M[4617] or places is not NORTH_AMERICA


def test_maps_in_cgcs2000_and_in_wgs_84_meet_in_a_pack(tmp_path: Path, write_raster) -> None:
    pixels = np.random.default_rng(1).integers(1, 255, (200, 200), dtype=np.uint8)
    write_raster(tmp_path / "a.tif", pixels, "EPSG:4547", (30.6, 114.3), 0.5)
    write_raster(tmp_path / "dsm.tif", np.full((150, 150), 33.0, np.float32), "EPSG:32650", (30.6, 114.3), 1.0)
    manifest = build_pack([tmp_path / "a.tif"], tmp_path / "dsm.tif", tmp_path / "pack")
    assert manifest.crs.epsg == 4547 and manifest.heights.share_known == 1.0
    pack = PackMap.open(tmp_path / "pack")
    assert pack.covers(30.6, 114.3) and pack.height_amsl_m(*pack.to_map(30.6, 114.3)) == 33.0
    assert registration_warnings([tmp_path / "a.tif"]) == []


@pytest.mark.parametrize(
    ("code", "place", "accuracy_m"),
    [
        ("EPSG:4326", (47.0, 9.0), 0.0),
        ("EPSG:32632", (47.0, 9.0), 0.0),
        ("EPSG:25832", (47.0, 9.0), 1.0),
        ("EPSG:26912", (40.0, -111.0), 4.0),
        ("EPSG:2955", (51.0, -114.0), 2.0),
        ("EPSG:4152", (40.0, -100.0), 2.0),
        ("EPSG:2193", (-41.3, 174.8), 2.0),
        ("EPSG:26717", (36.0, -80.0), 10.0),
        ("EPSG:23030", (40.0, -3.0), 1.5),
        ("EPSG:23032", (47.0, 9.0), 2.0),
    ],
)
def test_what_is_stated_of_the_relation_to_wgs_84_is_that_of_the_place(
    code: str, place: tuple[float, float], accuracy_m: float
) -> None:
    """ED50 has one for Spain and another for Germany. No grid of a country that another may have installed is better here."""
    crs = map_crs(map_crs(code).wkt)
    assert crs.accuracy_m(*crs.to_map(*place)) == accuracy_m


def test_compound_crs_keeps_its_vertical_unit() -> None:
    assert map_crs("EPSG:32612+5703").vertical_metres_per_unit == 1.0
    compound = map_crs("EPSG:32612+6360")
    assert compound.vertical_metres_per_unit == pytest.approx(0.3048006)
    assert "height" in compound.vertical_name
    assert compound == map_crs("EPSG:32612")


@pytest.mark.parametrize("text", ["EPSG:4978", "EPSG:5703", "nonsense", "EPSG:99999999"])
def test_no_horizontal_crs_is_refused(text: str) -> None:
    with pytest.raises(MapError, match=r"here\.tif.*remedy"):
        map_crs(text, "here.tif")


def test_unknown_datum_is_refused() -> None:
    wkt = (
        'GEOGCRS["?",DATUM["Moon somewhere",ELLIPSOID["Moon",1737400,0]],CS[ellipsoidal,2],'
        'AXIS["lat",north],AXIS["lon",east],ANGLEUNIT["degree",0.0174532925199433]]'
    )
    with pytest.raises(DatumMissing, match="relation"):
        map_crs(wkt, "moon.tif")


def renamed_datum(epsg: int) -> str:
    """WKT of a CRS as tables of another age write it: its datum has a name that PROJ here does not know."""
    datum = re.compile(r'(?:DATUM|ENSEMBLE)\["[^"]*",(?:MEMBER\["[^"]*"\],)*(ELLIPSOID\[.*?\]\])(?:,ENSEMBLEACCURACY\[[\d.]+\])?')
    return datum.sub(r'DATUM["ETRS89 of a country",\1', CRS.from_epsg(epsg).to_wkt(pretty=False), count=1)


@pytest.mark.parametrize("epsg", [3067, 5972])
def test_a_datum_of_newer_tables_is_known_by_the_code_of_its_crs(epsg: int) -> None:
    crs = map_crs(renamed_datum(epsg))
    assert crs == map_crs(f"EPSG:{epsg}") and crs.states_heights == (epsg == 5972)
    assert map_crs(crs.wkt) == crs


def test_a_code_that_does_not_fit_its_crs_is_not_believed() -> None:
    moved = renamed_datum(3067).replace('"False easting",500000', '"False easting",400000')
    with pytest.raises(DatumMissing, match="relation"):
        map_crs(moved, "moved.tif")


def test_places_without_coordinates() -> None:
    utm = map_crs("EPSG:32612")
    with pytest.raises(OutsideMap):
        utm.to_map(95.0, 10.0)
    with pytest.raises(OutsideMap):
        utm.to_geo(math.nan, 0.0)
    with pytest.raises(OutsideMap):
        utm.linearised_at(GeoPoint(math.nan, 10.0, 0.0))
    assert np.isnan(utm.to_map_array(np.array([[95.0, 10.0], [40.0, -111.0]]))).tolist() == [[True, True], [False, False]]


@pytest.mark.parametrize(
    ("lat", "lon", "epsg"),
    [
        *((47.0, 15.0, 32633), (-33.0, 18.4, 32734), (10.0, 179.9, 32660), (10.0, -180.0, 32601)),
        *((10.0, -180.00000000000003, 32601), (-10.0, -180.00000000000003, 32701)),
    ],
)
def test_utm_zone(lat: float, lon: float, epsg: int) -> None:
    assert utm_at(lat, lon).epsg == epsg
