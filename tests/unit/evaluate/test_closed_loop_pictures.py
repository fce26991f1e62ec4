"""Whole flights in a closed loop whose frames are rendered from a small world, and localised by the real methods."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import pytest

from visloc_companion.errors import ConfigError, MapError
from visloc_companion.evaluate.closed_loop import (
    FlightWorld,
    FlownScenario,
    fly,
)
from visloc_companion.evaluate.flight_pictures import picture_pairs
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import ProceduralWorld, scene_on
from visloc_companion.sim import faults
from visloc_companion.sim.scenarios import SCENARIOS, SEASON_CHANGE
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import (
    AutopilotKind,
    CameraModel,
    Fix,
    FrameRef,
    GeoPoint,
    NoFix,
)


def failed(flown: FlownScenario) -> list[str]:
    return [f"{check.name}: {check.value} (limit {check.limit})" for check in flown.checks if not check.passed]


@pytest.fixture(scope="module")
def small_world(kept_world: Callable[..., ProceduralWorld]) -> FlightWorld:
    files = kept_world(600.0, networks=())
    return FlightWorld(files.pack, PackMap.open(files.pack), Scene.load(files.flight_ortho, files.flight_dsm))


def test_home_and_reach_are_the_maps(small_world: FlightWorld) -> None:
    area = small_world.area()
    lat_deg, lon_deg = small_world.reference.to_geo(*small_world.reference.center_map_m)
    assert distance_m(area.home, GeoPoint(lat_deg, lon_deg, 0.0)) < 0.5
    assert area.reach_m == pytest.approx(300.0, abs=8.0)
    assert area.gsd_m == pytest.approx(0.5, rel=0.01)


def test_rendered_frames_and_the_real_localiser_carry_a_flight(small_world: FlightWorld) -> None:
    """Two dates years apart, jammed after 5 s of 13: the autopilot flies on what the gradient localiser finds."""
    scenario = replace(SCENARIOS["jam"], duration_s=13.0, frame_rate_hz=2.0, faults=faults.jam(5.0))
    told: list[float] = []
    setup = FlightSetup(scenario, small_world.area(), AutopilotKind.PX4, "copter", 1)
    flown = fly(setup, small_world, method="gradient", on_progress=told.append)
    assert flown.passed, failed(flown)
    assert told == [float(t_s) for t_s in range(13)]
    answers = [entry.event for entry in flown.log.entries if isinstance(entry.event, Fix | NoFix)]
    fixes = [answer for answer in answers if isinstance(answer, Fix)]
    assert len(fixes) > 0.8 * len(answers)
    off_m = [math.dist(fix.p_ned_m[:2], flown.record.truth.at(np.array([fix.t_s]))[0, :2]) for fix in flown.record.fixes]
    assert median(off_m) < 1.5
    [pair] = picture_pairs(flown, small_world, [6.0])
    camera, below = (cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for jpeg in (pair.camera, pair.map))
    assert camera is not None
    assert below is not None
    assert camera.shape == below.shape == (315, 420, 3)
    assert camera.std() > 5


def test_a_flight_over_a_polar_map_turned_by_half_a_right_angle(small_world: FlightWorld, tmp_path: Path) -> None:
    """As above, the same world at 75 degrees north, 45 degrees from where the polar stereographic grid points north."""
    middle = np.array(map_crs("EPSG:3413").to_map(75.0, 0.0))
    linear = np.diag([0.5, -0.5]) * map_crs("EPSG:3413").linearised_at(GeoPoint(75.0, 0.0, 0.0)).scale
    surface = small_world.reference.manifest.heights.grid
    assert surface is not None
    older = Scene.load(small_world.pack / small_world.reference.manifest.ortho.file, small_world.pack / surface.file)
    T_map_pix = np.column_stack([linear, middle - linear @ (np.array(older.size_px) - 1) / 2])
    polar = [replace(scene, T_map_pix=T_map_pix, crs="EPSG:3413") for scene in (older, small_world.scene)]
    build_pack(polar[0].save(tmp_path)[:1], tmp_path / "dsm.tif", tmp_path / "pack")
    world = FlightWorld(tmp_path / "pack", PackMap.open(tmp_path / "pack"), polar[1])
    scenario = replace(SCENARIOS["jam"], duration_s=13.0, frame_rate_hz=2.0, faults=faults.jam(5.0))
    setup = FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, "copter", 1, width_px=320)
    assert math.degrees(setup.area.turn_rad) == pytest.approx(45.0, abs=0.1)
    flown = fly(setup, world, method="gradient")
    assert flown.passed, failed(flown)
    assert len(flown.record.fixes) > 0.8 * flown.record.n_requests
    off_m = [math.dist(fix.p_ned_m[:2], flown.record.truth.at(np.array([fix.t_s]))[0, :2]) for fix in flown.record.fixes]
    assert median(off_m) < 1.5


def test_a_fisheye_of_150_degrees_carries_a_flight(small_world: FlightWorld) -> None:
    """As above, through a lens that bends: position, the camera's own motion and its pictures in the report."""
    lens = CameraModel(320, 240, 152.8, 152.8, 161.0, 118.0, (0.02, -0.01, 0.003, -0.001), "fisheye")
    scenario = replace(SCENARIOS["jam"], duration_s=13.0, frame_rate_hz=2.0, faults=faults.jam(5.0))
    setup = FlightSetup(scenario, small_world.area(), AutopilotKind.ARDUPILOT, "copter", 1, camera=lens)
    flown = fly(setup, small_world, method="gradient")
    assert flown.passed, failed(flown)
    assert {e.event.width_px for e in flown.log.entries if isinstance(e.event, FrameRef)} == {320}
    answers = [entry.event for entry in flown.log.entries if isinstance(entry.event, Fix | NoFix)]
    assert len(flown.record.fixes) > 0.8 * len(answers)
    truth = flown.record.truth
    off_m = [math.dist(fix.p_ned_m[:2], truth.at(np.array([fix.t_s]))[0, :2]) for fix in flown.record.fixes]
    assert median(off_m) < 1.5
    moves = [answer.motion for answer in answers if answer.motion is not None]
    assert len(moves) > 0.5 * len(answers)
    for move in moves:
        ends = truth.at((np.array([move.t_from_ns, move.t_to_ns]) - flown.record.t0_ns) * 1e-9)
        assert math.dist(move.displacement_ned_m[:2], (ends[1] - ends[0])[:2]) < 2.0
    [pair] = picture_pairs(flown, small_world, [6.0])
    pictures = [cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for jpeg in (pair.camera, pair.map)]
    assert [picture.shape[:2] for picture in pictures if picture is not None] == [(288, 420)] * 2


def test_structure_helps_where_snow_hides_what_the_image_is_known_by(small_world: FlightWorld) -> None:
    """Twelve seconds over deep snow, jammed after five: what the image does not recognise its shape places."""
    files = ProceduralWorld(small_world.pack, small_world.pack, small_world.pack)
    snow = replace(small_world, scene=Scene.load(*scene_on(files, "snow", 1, size_m=600.0)))
    scenario = replace(SEASON_CHANGE, duration_s=12.0, faults=faults.jam(5.0))
    setup = FlightSetup(scenario, snow.area(), AutopilotKind.ARDUPILOT, "copter", 1)
    record = fly(setup, snow, method="gradient").record
    methods = [fix.method for fix in record.fixes]
    assert methods.count("structure") >= 2
    assert [refusal.method for refusal in record.refusals].count("gradient") > methods.count("gradient")
    truth = record.truth.at(np.array([fix.t_s for fix in record.fixes]))
    off_m = [math.dist(fix.p_ned_m[:2], at[:2]) for fix, at in zip(record.fixes, truth, strict=True) if fix.method == "structure"]
    assert max(off_m) < 5.0


def test_a_map_with_a_hole_in_its_middle_is_refused(small_world: FlightWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PackMap, "height_amsl_m", lambda *_: math.nan)
    with pytest.raises(MapError, match="no surface height in its middle"):
        small_world.area()


def test_an_unknown_method_is_refused(small_world: FlightWorld) -> None:
    with pytest.raises(ConfigError, match="unknown method 'guess'"):
        fly(FlightSetup(SCENARIOS["jam"], small_world.area(), AutopilotKind.PX4, "copter", 1), small_world, method="guess")
