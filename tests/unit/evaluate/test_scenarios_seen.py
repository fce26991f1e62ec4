"""The scenarios in which it matters what the camera sees, flown over rendered pictures with the localiser that flies.

One small world for all of them. Flights without pictures are in test_closed_loop.py, deep snow in test_closed_loop_pictures.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.evaluate.closed_loop import FlightWorld, fly
from visloc_companion.geo.camera import project
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import ProceduralWorld
from visloc_companion.sim import faults
from visloc_companion.sim.scenarios import SCENARIOS, SEASON_CHANGE, Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.seen import met_in_time, mounting, seen_ground, simulated_camera, way_pix
from visloc_companion.sim.setup import SPEED_MPS, FlightArea, FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind, GeoPoint

SEEN = [scenario for scenario in SCENARIOS.values() if scenario.pictures and scenario is not SEASON_CHANGE]
SIZE_M, WIDTH_PX = 800.0, 320
RATE_HZ, RARER_HZ = 0.5, {"open_sea": 0.125, "over_water": 0.375}
"""Rarer than the scenarios' own, and still rarer over water: frames that are lost are searched for over all in reach: minutes."""


@pytest.fixture(scope="session")
def world(kept_world: Callable[..., ProceduralWorld]) -> FlightWorld:
    files = kept_world(SIZE_M)
    cv2.setNumThreads(1)
    return FlightWorld(files.pack, PackMap.open(files.pack), Scene.load(files.flight_ortho, files.flight_dsm))


def setup_of(scenario: Scenario, world: FlightWorld) -> FlightSetup:
    return FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, "copter", 1, width_px=WIDTH_PX)


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("scenario", SEEN, ids=lambda scenario: scenario.name)
def test_every_scenario_that_is_seen_meets_its_expectation(scenario: Scenario, world: FlightWorld) -> None:
    rate_hz = min(scenario.frame_rate_hz, RARER_HZ.get(scenario.name, RATE_HZ))
    flown = fly(setup_of(replace(scenario, frame_rate_hz=rate_hz), world), world)
    assert flown.passed, [f"{check.name}: {check.value} (limit {check.limit})" for check in flown.checks if not check.passed]


def test_the_ground_is_as_the_map_has_it_where_nothing_changes(world: FlightWorld) -> None:
    ground, water = seen_ground(setup_of(SCENARIOS["jam"], world), world.scene)
    assert ground is world.scene
    assert water is None


def test_a_shifted_map_is_a_shifted_world(world: FlightWorld) -> None:
    """The map lies 8 m east of the truth, so what the camera sees lies 8 m west of where the map has it."""
    ground, _ = seen_ground(setup_of(SCENARIOS["map_shifted"], world), world.scene)
    moved = ground.T_map_pix[:, 2] - world.scene.T_map_pix[:, 2]
    assert moved == pytest.approx((-8.0, 0.0), abs=0.3), "up to the grid's convergence"


def test_water_lies_where_the_way_passes(world: FlightWorld) -> None:
    setup = setup_of(SCENARIOS["over_water"], world)
    ground, water = seen_ground(setup, world.scene)
    assert water is not None
    way = way_pix(setup, ground)
    leg = way[1] - way[0]
    at = way[0] + leg / np.linalg.norm(leg) * np.array([100.0, 360.0])[:, None] / 0.5
    assert [bool(water[round(v), round(u)]) for u, v in at] == [False, True]


@pytest.mark.parametrize(
    ("vehicle", "reach_m", "name", "between_m"),
    [
        ("copter", 1000.0, "over_water", (250.0, 600.0)),
        ("plane", 1000.0, "over_water", (625.0, 975.0)),
        ("plane", 1000.0, "stale_map", (625.0, math.inf)),
        ("plane", 170.0, "over_water", (250.0, 600.0)),
    ],
)
def test_a_plane_meets_a_change_at_the_same_second(
    vehicle: VehicleKind, reach_m: float, name: str, between_m: tuple[float, float]
) -> None:
    """The water began 5 s before the jamming of a plane, which could never be aiding first; a way of 500 m leaves no choice."""
    area = FlightArea(GeoPoint(47.4, 8.55, 480.0), reach_m, 0.5)
    setup = FlightSetup(SCENARIOS[name], area, AutopilotKind.PX4, vehicle, 1)
    for change in SCENARIOS[name].changes:
        met = met_in_time(change, setup)
        assert (met.begin_m, met.end_m) == between_m
        assert replace(met, begin_m=0.0, end_m=0.0) == replace(change, begin_m=0.0, end_m=0.0)


def test_a_planes_water_lies_further_on(world: FlightWorld) -> None:
    setup = replace(setup_of(SCENARIOS["over_water"], world), vehicle="plane")
    ground, water = seen_ground(setup, world.scene)
    assert water is not None
    way = way_pix(setup, ground)
    lengths_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T)) * 0.5])
    at = np.column_stack([np.interp([425.0, 800.0], lengths_m, way[:, axis]) for axis in (0, 1)])
    assert [bool(water[round(v), round(u)]) for u, v in at] == [False, True]


@pytest.mark.parametrize("vehicle", ["copter", "plane"])
def test_nobody_comes_back_from_the_open_sea(vehicle: VehicleKind) -> None:
    """A plane was back over the land of its first metres after 117 s, was recognised there, and never lost."""
    scenario = SCENARIOS["open_sea"]
    area = FlightArea(GeoPoint(47.4, 8.55, 480.0), 1000.0, 0.5)
    setup = FlightSetup(scenario, area, AutopilotKind.ARDUPILOT, vehicle, 1)
    way = np.array([(*point[:2],) for point in setup.mission_ned_m()])
    lengths_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    flown_m = 1.2 * SPEED_MPS[vehicle] * scenario.duration_s
    assert lengths_m[-1] > flown_m
    at_m = np.arange(0.0, flown_m, 5.0)
    places = np.column_stack([np.interp(at_m, lengths_m, axis) for axis in way.T])
    change = met_in_time(scenario.changes[0], setup)
    land, later = places[at_m < change.begin_m], places[at_m > lengths_m[2]]
    nearest_m = min(float(np.hypot(*(land - place).T).min()) for place in later)
    assert nearest_m > 2 * (change.half_width_m + setup.height_m * math.tan(math.radians(30.0)))


def test_the_land_beyond_the_map_reaches_as_far_as_is_seen(world: FlightWorld) -> None:
    setup = setup_of(SCENARIOS["map_edge"], world)
    ground, _ = seen_ground(setup, world.scene)
    furthest = way_pix(setup, ground)
    assert (furthest[:, 1].min()) > 2 * setup.height_m * 0.4 / 0.5


def test_lens_and_mounting_are_what_they_are_not_what_is_believed(world: FlightWorld) -> None:
    """A point straight ahead of the configured axis appears where the true mounting and the true lens put it."""
    scenario = Scenario("wrong", "Wrong.", 60.0, faults.these(faults.FocalError(0.03), faults.MountError(yaw_rad=0.1)))
    setup = setup_of(scenario, world)
    right = setup_of(Scenario("right", "Right.", 60.0, faults.FaultSchedule()), world)
    place = geo_from_ned((0.0, 0.0, -120.0), setup.area.home)
    seen, wanted = (simulated_camera(each, world.scene).render(place, (1.0, 0.0, 0.0, 0.0), 1) for each in (setup, right))
    assert simulated_camera(setup, world.scene).model == setup.camera_model()
    turn = cv2.getRotationMatrix2D((159.5, 119.5), 0.0, 1.03)
    c, s = np.cos(-0.1), np.sin(-0.1)
    turn[:, :2] = 1.03 * np.array([[c, -s], [s, c]])
    turn[:, 2] = np.array([159.5, 119.5]) - turn[:, :2] @ [159.5, 119.5]
    moved = cv2.warpAffine(wanted, turn, (320, 240))
    inside = (slice(75, 165), slice(110, 210))
    likeness = [float(np.corrcoef(a[inside].ravel(), seen[inside].ravel())[0, 1]) for a in (wanted, moved)]
    assert likeness[1] > max(0.7, likeness[0] + 0.1)
    assert mounting(setup) == (1.0, 0.0, 0.0, 0.0)
    assert project(setup.camera_model(), np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx((159.5, 119.5))
