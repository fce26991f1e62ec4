import math
import statistics
from random import Random

import pytest

from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.autopilots.control import Estimated, MissionPath
from visloc_companion.sim.autopilots.control_plane import PlaneControl
from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body
from visloc_companion.sim.vehicles.vehicle_copter import Copter, CopterCommand
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov, Wind
from visloc_companion.sim.vehicles.vehicle_plane import Plane, PlaneCommand
from visloc_companion.types import AutopilotKind, GeoPoint

HOME = GeoPoint(47.3977, 8.5456, 488.0)
CALM = (0.0, 0.0, 0.0)


def test_a_copter_leans_nose_down_to_go_forward():
    body = Body(down=-50.0, yaw=math.pi / 2)
    copter = Copter(body)
    for _ in range(300):
        copter.step(CopterCommand(2.0, 0.0, 0.0, 0.0), CALM, 0.01)
    assert body.pitch == pytest.approx(-math.atan2(2.0, GRAVITY_MPS2), abs=0.01)
    assert body.v_east > 4.0
    assert abs(body.v_north) < 0.01


def test_a_level_copter_drifts_with_the_wind():
    body = Body(down=-50.0)
    copter = Copter(body)
    for _ in range(6000):
        copter.step(CopterCommand(0.0, 0.0, 0.0, 0.0), (4.0, -3.0, 0.0), 0.01)
    assert (body.v_north, body.v_east) == pytest.approx((4.0, -3.0), abs=0.05)


def test_velocity_and_position_are_consistent_with_acceleration_and_rates_with_attitude():
    body = Body(down=-50.0)
    copter = Copter(body)
    for i in range(500):
        before, yaw = (body.north, body.v_north), body.yaw
        copter.step(CopterCommand(math.sin(i / 50), 0.0, 0.0, 0.3), CALM, 0.01)
        assert body.v_north - before[1] == pytest.approx(body.a_north * 0.01)
        assert body.north - before[0] == pytest.approx((body.v_north + before[1]) / 2 * 0.01)
    assert (body.yaw - yaw) / 0.01 == pytest.approx(body.rate_z, abs=0.02)


def test_a_copter_comes_to_rest_on_the_ground_and_takes_off_again():
    body = Body(down=-2.0)
    copter = Copter(body)
    for _ in range(600):
        copter.step(CopterCommand(0.0, 0.0, 0.5, 0.0), CALM, 0.01)
    assert body.landed
    assert (body.down, body.v_down) == (0.0, 0.0)
    for _ in range(300):
        copter.step(CopterCommand(0.0, 0.0, -1.0, 0.0), CALM, 0.01)
    assert body.down < -2.0


@pytest.mark.parametrize("command", [50.0, -50.0])
def test_climb_and_descent_are_limited(command):
    body = Body(down=-5000.0)
    copter = Copter(body)
    for _ in range(2000):
        copter.step(CopterCommand(0.0, 0.0, command, 0.0), CALM, 0.01)
    assert abs(body.v_down) == pytest.approx(Copter.MAX_CLIMB_MPS, rel=0.05)


def test_a_banked_plane_turns_coordinated_and_drifts_with_the_air():
    body = Body(down=-100.0, v_north=25.0)
    plane = Plane(body, 25.0)
    for _ in range(500):
        plane.step(PlaneCommand(math.radians(30), 0.0, 25.0), (0.0, 6.0, 0.0), 0.01)
    assert body.roll == pytest.approx(math.radians(30), abs=0.01)
    turn = body.rate_z * math.cos(body.roll) + body.rate_y * math.sin(body.roll)
    assert turn == pytest.approx(GRAVITY_MPS2 * math.tan(body.roll) / 25.0, rel=0.02)
    air = math.hypot(body.v_north, body.v_east - 6.0)
    assert air == pytest.approx(25.0, abs=0.1)


def test_gauss_markov_has_its_sigma_and_correlation():
    noise = GaussMarkov(Random(3), 2.0, 5.0)
    values = [noise.step(0.1) for _ in range(60000)]
    assert statistics.pstdev(values) == pytest.approx(2.0, rel=0.15)
    lagged = statistics.correlation(values[:-50], values[50:])
    assert lagged == pytest.approx(math.exp(-1), abs=0.12)


def test_wind_blows_as_told_on_average_with_gusts():
    wind = Wind(Random(2), (6.0, 0.0, 0.0), 10.0, 0.1)
    values = [wind.step(0.1)[0] for _ in range(50000)]
    assert statistics.fmean(values) == pytest.approx(6.0, abs=0.15)
    assert statistics.pstdev(values) == pytest.approx(0.6, rel=0.2)


@pytest.mark.parametrize(
    ("vehicle", "speed_mps", "side_m", "off_m"), [("copter", 10.0, 240.0, 6.0), ("plane", 25.0, 900.0, 60.0)]
)
def test_a_vehicle_flies_round_its_mission(vehicle, speed_mps, side_m, off_m):
    corners = [(0.0, 0.0), (side_m, 0.0), (side_m, side_m), (0.0, side_m)]
    mission = [(n, e, -100.0) for n, e in corners]
    pilot = BuiltInAutopilot(AutopilotKind.PX4, vehicle, HOME, mission, speed_mps, 5, wind_ned_mps=(3.0, -2.0, 0.0))
    nearest = dict.fromkeys(corners, math.inf)
    heights = []
    for _ in range(400):
        pilot.step(0.5)
        north, east, down = pilot.truth().p_ned_m
        heights.append(-down)
        for corner in corners:
            nearest[corner] = min(nearest[corner], math.dist(corner, (north, east)))
    assert max(nearest.values()) < off_m
    assert max(abs(h - 100.0) for h in heights) < 4.0
    assert pilot.mode == "mission"


def test_a_plane_loiters_about_a_single_waypoint():
    pilot = BuiltInAutopilot(AutopilotKind.ARDUPILOT, "plane", HOME, [(100.0, 0.0, -120.0)], 20.0, 1, wind_ned_mps=(4.0, 0, 0))
    pilot.step(60.0)
    radii = []
    for _ in range(60):
        pilot.step(1.0)
        north, east, _ = pilot.truth().p_ned_m
        radii.append(math.hypot(north - 100.0, east))
    assert max(radii) - min(radii) < 25.0
    assert 80.0 < statistics.fmean(radii) < 130.0


def test_a_plane_told_to_land_circles_down_to_the_ground():
    body = Body(down=-20.0, v_north=20.0)
    control = PlaneControl(Plane(body, 20.0), 20.0)
    for _ in range(2500):
        control.fly("land", Estimated(0, 0, body.down, 0, 0, body.v_down, body.yaw, False), -20.0, CALM, 0.01)
    assert body.landed
    assert math.hypot(body.north, body.east) < 400.0


@pytest.mark.parametrize("waypoints", [[(5.0, 5.0, -30.0)], [(5.0, 5.0, -30.0)] * 3])
def test_waypoints_that_are_all_the_same_are_a_place_to_stay_at(waypoints):
    point = MissionPath(waypoints).at(8.0, 9.0, 2.0)
    assert point.single
    assert (point.cross_north, point.cross_east, point.down_m) == (3.0, 4.0, -30.0)


def test_the_path_goes_on_to_the_next_leg_and_interpolates_the_height():
    path = MissionPath([(0.0, 0.0, -20.0), (100.0, 0.0, -40.0), (100.0, 100.0, -40.0)])
    half = path.at(50.0, 3.0, 2.0)
    assert (half.along_north, half.along_east) == (1.0, 0.0)
    assert (half.cross_north, half.cross_east) == (0.0, 3.0)
    assert (half.remaining_m, half.down_m) == pytest.approx((50.0, -30.0))
    assert path.at(99.0, 0.0, 2.0).along_east == 1.0


def test_a_mission_without_waypoints_is_refused():
    with pytest.raises(ValueError, match="waypoint"):
        MissionPath([])
