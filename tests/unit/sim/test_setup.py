"""A flight that fits its map."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.errors import MapError
from visloc_companion.geo.wgs84 import distance_m, ned_from_geo
from visloc_companion.sim.faults import FaultSchedule
from visloc_companion.sim.scenarios import SCENARIOS, Scenario
from visloc_companion.sim.setup import FlightArea, FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind, CameraModel, GeoPoint, Mode

HOME = GeoPoint(47.4, 8.55, 480.0)
VEHICLES: tuple[VehicleKind, ...] = ("copter", "plane")
CALM = Scenario("calm", "Nothing goes wrong.", 120.0, FaultSchedule())


def setup_of(reach_m: float, gsd_m: float = 0.5, vehicle: VehicleKind = "copter") -> FlightSetup:
    return FlightSetup(CALM, FlightArea(HOME, reach_m, gsd_m), AutopilotKind.ARDUPILOT, vehicle, 1)


@pytest.mark.parametrize(("reach_m", "gsd_m"), [(160.0, 0.5), (300.0, 0.3), (1000.0, 0.5), (2000.0, 5.0), (9000.0, 5.0)])
def test_the_footprint_stays_on_the_map(reach_m: float, gsd_m: float) -> None:
    """At every waypoint the half width of the level frame, and a third more for the tilt, is on the map."""
    setup = setup_of(reach_m, gsd_m)
    model = setup.camera_model()
    half_m = setup.height_m * model.width_px / 2 / model.fx_px
    assert half_m == pytest.approx(setup.height_m * math.tan(math.radians(30.0)))
    for north_m, east_m, down_m in setup.mission_ned_m():
        assert max(abs(north_m), abs(east_m)) + 1.3 * half_m <= reach_m
        assert down_m == -setup.height_m


def test_all_that_a_wide_lens_is_looked_at_for_stays_on_the_map() -> None:
    """A fisheye's frame is taken for a pinhole's of up to 55° to each side, whatever its focal length and width would make."""
    lens = CameraModel(320, 240, 110.0, 110.0, 159.5, 119.5, (0.0, 0.0, 0.0, 0.0), "fisheye")
    setup = replace(setup_of(400.0), camera=lens)
    assert setup.camera_model() is lens
    reach_m = setup.height_m * math.tan(math.radians(55.0))
    furthest_m = max(max(abs(north_m), abs(east_m)) for north_m, east_m, _ in setup.mission_ned_m())
    assert furthest_m + 1.3 * reach_m == pytest.approx(400.0, abs=20.0)
    assert furthest_m + 1.3 * reach_m <= 400.0


def test_a_coarse_map_is_flown_higher() -> None:
    assert setup_of(1000.0, 0.3).height_m == 120.0
    coarse = setup_of(3000.0, 5.0)
    assert coarse.height_m == 750.0
    footprint_px = 2 * coarse.height_m * math.tan(math.radians(30.0)) / 5.0
    assert footprint_px == pytest.approx(173.2, abs=0.1)


def test_a_height_that_is_asked_for_is_flown() -> None:
    low = replace(setup_of(1500.0, 5.0), height_asked_m=277.0)
    assert low.height_m == 277.0
    assert {down_m for _, _, down_m in low.mission_ned_m()} == {-277.0}


def test_a_map_that_is_too_small_is_refused_with_the_size_that_would_do() -> None:
    with pytest.raises(MapError, match=r"reach 100 m .* remedy: give a map and an orthophoto that reach 157 m") as caught:
        setup_of(100.0).autopilot()
    needed_m = float(caught.value.remedy.split(" m ")[0].split()[-1])
    assert setup_of(needed_m + 0.5).mission_ned_m()


@pytest.mark.parametrize("vehicle", ["copter", "plane"])
def test_the_vehicle_stays_near_its_mission(vehicle: VehicleKind) -> None:
    """Two minutes with wind and gusts: the vehicle begins at the first waypoint and never leaves the map."""
    setup = setup_of(1000.0, vehicle=vehicle)
    pilot = setup.autopilot(boot_age_s=3.0)
    start = ned_from_geo(pilot.truth().place, HOME)
    assert start == pytest.approx(setup.mission_ned_m()[0], abs=0.1)
    assert pilot.t_boot_ns == 3_000_000_000
    speeds = []
    for _ in range(120):
        pilot.step(1.0)
        place = pilot.truth().place
        assert distance_m(place, HOME) < 800.0
        assert place.h_amsl_m - HOME.h_amsl_m == pytest.approx(120.0, abs=15.0)
        speeds.append(math.hypot(*pilot.truth().v_ned_mps[:2]))
    assert sum(speeds) / len(speeds) == pytest.approx(10.0 if vehicle == "copter" else 25.0, rel=0.25)


def test_the_scenario_reaches_the_autopilot() -> None:
    setup = replace(setup_of(1000.0), scenario=SCENARIOS["camera_freeze"], kind=AutopilotKind.PX4)
    pilot = setup.autopilot()
    assert pilot.kind is AutopilotKind.PX4
    assert pilot.faults == SCENARIOS["camera_freeze"].faults


def test_a_plane_is_judged_by_its_own_limits() -> None:
    """What is not told of a turn grows with the speed."""
    copter, plane = (replace(setup_of(1000.0, vehicle=each), scenario=SCENARIOS["link_gaps"]) for each in VEHICLES)
    assert copter.judged_as is copter.scenario
    assert (copter.judged_as.expected.max_error_m, plane.judged_as.expected.max_error_m) == (10.0, 32.0)
    told = replace(plane.judged_as.expected, max_error_m=10.0, final_modes=copter.scenario.expected.final_modes)
    assert told == copter.scenario.expected
    jammed = replace(plane, scenario=SCENARIOS["jam"]).judged_as.expected
    assert jammed.final_modes == (*SCENARIOS["jam"].expected.final_modes, Mode.DEAD_RECKONING)
    assert replace(jammed, final_modes=SCENARIOS["jam"].expected.final_modes) == SCENARIOS["jam"].expected
