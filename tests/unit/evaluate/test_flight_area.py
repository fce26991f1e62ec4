"""Where a flight may go over maps whose grid points north, and over those whose grid is turned."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visloc_companion.errors import MapError
from visloc_companion.evaluate.closed_loop import FlightWorld
from visloc_companion.evaluate.flight_area import corners_reach_m
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.scenarios import Course, Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import way_pix
from visloc_companion.sim.setup import FlightArea, FlightSetup
from visloc_companion.types import AutopilotKind, FloatArray, GeoPoint

PIXEL = 2.0


def world_at(
    folder: Path, crs: str, at: tuple[float, float], size_px: tuple[int, int] = (400, 400), turn_deg: float = 0.0
) -> FlightWorld:
    """Noise of 2 map units a pixel about a place, a pack and what the camera sees; that raster turned against its own grid."""
    width, height = size_px
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    linear = np.array([[c, -s], [s, c]]) @ np.diag([PIXEL, -PIXEL])
    corner = np.array(map_crs(crs).to_map(*at)) - linear @ [(width - 1) / 2, (height - 1) / 2]
    pixels = np.random.default_rng(1).integers(1, 255, (height, width, 3), np.uint8)
    scene = Scene(pixels, np.full((height, width), 20.0, np.float32), np.column_stack([linear, corner]), crs)
    ortho, dsm = scene.save(folder)
    build_pack([ortho], dsm, folder / "pack")
    return FlightWorld(folder / "pack", PackMap.open(folder / "pack"), scene)


def setup_on(area: FlightArea, name: Course = "loop") -> FlightSetup:
    scenario = Scenario("calm", "Nothing goes wrong.", 60.0, FaultSchedule(), course=name)
    return FlightSetup(scenario, area, AutopilotKind.ARDUPILOT, "copter", 1, height_asked_m=120.0)


def course(area: FlightArea, name: Course = "loop") -> list[tuple[float, float, float]]:
    return list(setup_on(area, name).mission_ned_m())


def from_edge_m(world: FlightWorld, home: GeoPoint, way: list[tuple[float, float, float]]) -> FloatArray:
    """(N,) how far inside the scene each waypoint lies, metres."""
    crs, T = map_crs(world.scene.crs), invert_affine(world.scene.T_map_pix)
    places = [geo_from_ned(point, home) for point in way]
    pix = np.array([apply_affine(T, np.array(crs.to_map(place.lat_deg, place.lon_deg))) for place in places])
    inside_px = np.minimum(pix + 0.5, np.array(world.scene.size_px) - 0.5 - pix).min(axis=1)
    return np.asarray(inside_px * PIXEL / crs.linearised_at(home).scale, np.float64)


@pytest.mark.parametrize(
    ("crs", "at", "turn_deg"),
    [
        ("EPSG:3413", (75.0, 0.0), 45.0),
        ("EPSG:3413", (75.0, -15.0), 30.0),
        ("EPSG:3413", (75.0, 15.0), -30.0),
        ("EPSG:3031", (-75.0, -40.0), 40.0),
    ],
)
def test_over_a_polar_map_the_course_lies_along_its_sides(
    crs: str, at: tuple[float, float], turn_deg: float, tmp_path: Path
) -> None:
    """The reach was taken from the corners' latitudes and longitudes: 0 of 400 m at 45 degrees, and the map was refused."""
    world = world_at(tmp_path, crs, at)
    area = world.area()
    reach_m = 400.0 / map_crs(crs).linearised_at(area.home).scale
    assert math.degrees(area.turn_rad) == pytest.approx(turn_deg, abs=0.1)
    assert area.reach_m == pytest.approx(reach_m, abs=1.0)
    footprint_m = 1.3 * 120.0 * math.tan(math.radians(30.0))
    courses: tuple[Course, ...] = ("loop", "zigzag", "out_to_sea")
    for name in courses:
        assert from_edge_m(world, area.home, course(area, name)).min() > footprint_m
    over_the_edge = from_edge_m(world, area.home, course(area, "over_the_edge"))
    assert over_the_edge[[0, 3]] == pytest.approx(300.0, abs=1.0)
    assert over_the_edge[[1, 2]] == pytest.approx(-130.0, abs=1.0)


@pytest.mark.parametrize(
    ("crs", "at", "waypoint_m"),
    [
        ("EPSG:32632", (47.4, 8.55), (276.0713518877314, -165.64281113263883)),
        ("EPSG:32632", (47.4, 10.9), (269.1940804164912, -161.51644824989472)),
        ("EPSG:3413", (75.0, -41.0), (256.53091657195995, -153.91854994317598)),
    ],
)
def test_a_map_that_is_hardly_turned_is_flown_along_north_and_east(
    crs: str, at: tuple[float, float], waypoint_m: tuple[float, float], tmp_path: Path
) -> None:
    """Every figure of docs/scenarios.md is of these courses."""
    world = world_at(tmp_path, crs, at)
    area = world.area()
    assert area.turn_rad == 0.0
    assert area.reach_m == min(corners_reach_m(world.reference, area.home), world.scene.reach_m(area.home))
    assert course(area)[0][:2] == pytest.approx(waypoint_m, abs=1e-6)


def test_a_course_across_the_antimeridian_lies_on_the_scene(tmp_path: Path) -> None:
    """The camera's orthophoto in degrees, whose eastings go on beyond 180: half of the course lay 38 million pixels away."""
    world = world_at(tmp_path, "EPSG:32760", (-17.5, 179.9999))
    pixel_deg = 1.9e-5
    corner = (179.9999 - 200 * pixel_deg, -17.5 + 200 * pixel_deg)
    T_map_pix = np.array([[pixel_deg, 0.0, corner[0]], [0.0, -pixel_deg, corner[1]]])
    degrees = replace(world, scene=replace(world.scene, T_map_pix=T_map_pix, crs="EPSG:4326"))
    setup = setup_on(degrees.area())
    lons_deg = [geo_from_ned(point, setup.area.home).lon_deg for point in setup.mission_ned_m()]
    assert min(lons_deg) < 0.0 < max(lons_deg)
    way = way_pix(setup, degrees.scene)
    assert way.min() > 0.0
    assert way.max() < 400.0


def test_over_a_long_strip_a_turn_of_three_degrees_is_reckoned_with(tmp_path: Path) -> None:
    """12 km by 1 km: its ends lie 300 m beside its middle, and the reach came to 145 of 500 m."""
    area = world_at(tmp_path, "EPSG:32633", (78.0, 17.9), size_px=(6000, 500)).area()
    assert math.degrees(area.turn_rad) == pytest.approx(2.84, abs=0.05)
    assert area.reach_m == pytest.approx(500.0, abs=15.0), "the pack's grid goes on for some pixels"


def test_a_turned_orthophoto_is_seen_along_its_own_sides(tmp_path: Path) -> None:
    """The pack about it is the upright rectangle that holds it; its sides are where the camera sees nothing any more."""
    world = world_at(tmp_path, "EPSG:32632", (47.4, 9.0), turn_deg=30.0)
    area = world.area()
    assert math.degrees(area.turn_rad) == pytest.approx(-30.0, abs=0.1)
    assert area.reach_m == pytest.approx(400.0, abs=5.0), "the pack's grid goes on for some pixels"
    assert from_edge_m(world, area.home, course(area)).min() > 1.3 * 120.0 * math.tan(math.radians(30.0))


def test_a_survey_that_is_no_upright_rectangle_is_flown_where_it_shows_something(tmp_path: Path) -> None:
    """Over the pack's own picture of a survey turned by 45 degrees the first waypoint lay where the map holds nothing."""
    turned = world_at(tmp_path, "EPSG:32632", (47.4, 9.0), turn_deg=45.0)
    own = replace(turned, scene=Scene.load(turned.pack / turned.reference.manifest.ortho.file))
    area = own.area()
    assert area.turn_rad == 0.0
    assert area.reach_m == pytest.approx(0.58 * 400.0 * math.sqrt(2.0), rel=0.04), "a square of it is 95 % full"
    assert from_edge_m(turned, area.home, course(area)).min() > 1.1 * 120.0 * math.tan(math.radians(30.0))


def test_holes_cost_no_reach(write_raster: Any, tmp_path: Path) -> None:
    """A missing tile, 4 % of the map, some of it below the flight."""
    pixels = np.random.default_rng(1).integers(1, 255, (400, 400, 3), np.uint8)
    pixels[180:260, 210:290] = 0
    write_raster(tmp_path / "ortho.tif", pixels, "EPSG:32632", (47.4, 9.0), 2.0, nodata=0)
    build_pack([tmp_path / "ortho.tif"], None, tmp_path / "pack")
    world = FlightWorld(tmp_path / "pack", PackMap.open(tmp_path / "pack"), Scene.load(tmp_path / "ortho.tif"))
    area = world.area()
    shown = world.reference.picture(world.reference.T_map_pix, (400, 400))[1]
    assert shown.mean() == pytest.approx(0.96, abs=0.005)
    assert area.reach_m == min(corners_reach_m(world.reference, area.home), world.scene.reach_m(area.home))


def test_a_turned_map_that_is_too_small_is_refused_with_the_size_that_would_do(tmp_path: Path) -> None:
    area = world_at(tmp_path, "EPSG:3413", (75.0, 0.0), size_px=(150, 150)).area()
    with pytest.raises(MapError, match=r"reach 152 m from the middle.* remedy: give a map and an orthophoto that reach 157 m"):
        course(area)
