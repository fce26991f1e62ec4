"""The physics of the simulated vehicles, and the sets that stand beside the makers' simulators."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.companion_status import computer_status
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.estimators.estimator_output import Due, OutputTaus, output_taus
from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body
from visloc_companion.sim.vehicles.accelerometer import Accelerometer
from visloc_companion.sim.vehicles.pitot import Pitot
from visloc_companion.sim.vehicles.vehicle_copter import Copter, CopterCommand
from visloc_companion.sim.vehicles.vehicle_model import (
    ARDUPILOT_SITL,
    POSITION_BYTES,
    PX4_SIH,
    STATUS_BYTES,
    USUAL,
    Accelerometers,
    Drag,
    VehicleModel,
)
from visloc_companion.types import AutopilotKind, ComputerLoad, GeoPoint

CALM = (0.0, 0.0, 0.0)
HOME = GeoPoint(47.3977, 8.5456, 488.0)
MODELS = {"usual": USUAL, "SITL": ARDUPILOT_SITL, "SIH": PX4_SIH}
LEVEL = CopterCommand(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("model", "per_s"), [(USUAL, 0.23), (PX4_SIH, 1.0)], ids=["usual", "SIH"])
def test_linear_drag_alone_slows_a_level_copter_with_its_time_constant(model: VehicleModel, per_s: float) -> None:
    body = Body(down=-50.0, v_north=8.0)
    copter = Copter(body, model.drag)
    for _ in range(round(100 / per_s)):
        copter.step(LEVEL, CALM, 0.01)
    assert body.v_north == pytest.approx(8.0 / math.e, rel=0.01)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("lean_deg", [10.0, 25.0])
def test_a_leaning_copter_comes_to_the_speed_at_which_drag_is_what_leans_it(model: VehicleModel, lean_deg: float) -> None:
    body, pull = Body(down=-50.0), GRAVITY_MPS2 * math.tan(math.radians(lean_deg))
    copter = Copter(body, model.drag, model.lean_rad)
    for _ in range(4000):
        copter.step(replace(LEVEL, forward_mps2=pull), CALM, 0.01)
    v = body.v_north
    assert model.drag.per_s * v + model.drag.per_m * v * v == pytest.approx(pull, rel=0.01)


def test_the_drag_of_ardupilots_simulator_is_its_reference_test() -> None:
    """45 degrees at 15.08 m/s, that is 10.66 m/s along the leaning body; its axes are the body's (SIM_Frame.h)."""
    v = 15.08 * math.cos(math.radians(45))
    along_body = GRAVITY_MPS2 * math.sin(math.radians(45))
    assert ARDUPILOT_SITL.drag.per_s * v + ARDUPILOT_SITL.drag.per_m * v * v == pytest.approx(along_body, rel=0.1)


def test_along_the_bodys_axes_accelerometers_feel_drag_alone_also_in_a_climb() -> None:
    body = Body(down=-50.0, v_north=6.0)
    copter = Copter(body, Drag(0.3))
    ideal = Accelerometer(Random(1), Accelerometers(0.0, noise_mps2=CALM))
    for step in range(150):
        copter.step(CopterCommand(2.0, 0.0, -3.0, 0.0), CALM, 0.01)
        if step > 60:
            forward, right, _ = ideal.measured(body, step * 0.01)
            drag = -0.3 * (body.v_north * math.cos(body.pitch) - body.v_down * math.sin(body.pitch))
            assert (forward, right) == pytest.approx((drag, 0.0), abs=0.02)


@pytest.mark.parametrize(("model", "bias_mps2"), [(USUAL, 0.15), (ARDUPILOT_SITL, 0.0)], ids=["usual", "SITL"])
def test_biases_wander_as_the_model_says(model: VehicleModel, bias_mps2: float) -> None:
    quiet = replace(model.accelerometers, noise_mps2=CALM)
    first = [Accelerometer(Random(seed), quiet).measured(Body(), 1.0)[0] for seed in range(400)]
    assert statistics.pstdev(first) == pytest.approx(bias_mps2, rel=0.15)


def test_a_tube_reads_its_scale() -> None:
    read = [Pitot(Random(seed), ARDUPILOT_SITL.tube).measured_mps(Body(v_north=20.0), CALM) for seed in range(400)]
    assert statistics.fmean(read) == pytest.approx(20.0 * 0.906, abs=0.1)
    assert statistics.pstdev(read) == pytest.approx(0.63, rel=0.15)


def test_the_bytes_that_make_ardupilot_stamp_early_are_those_that_the_daemon_sends() -> None:
    ours = mavlink.MAVLink(None, srcSystem=1, srcComponent=197)
    pose = mavlink.MAVLink_vision_position_estimate_message(2**50, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, [1.0] * 21, 1)
    status = computer_status(ComputerLoad(9e3, (0.5,) * 4, 50.0, 2**31, 2**32, 2**33, 2**34), 10**18)
    assert len(pose.pack(ours)) == POSITION_BYTES
    assert len(status.pack(ours)) == STATUS_BYTES


@pytest.mark.parametrize("early_s", [0.0, 0.1])
def test_positions_stamped_early_put_ardupilot_ahead_on_its_way(companion: Callable[..., Any], early_s: float) -> None:
    model = replace(ARDUPILOT_SITL, stamped_early_s=early_s)
    flight = companion(mission=[(0, 0, -40), (900, 0, -40)], sigma_m=0.02, latency_s=0.0, model=model)
    flight.fly(20.0)
    flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
    flight.fly(20.0)
    ahead = []
    flight.fly(30.0, lambda: ahead.append(flight.estimated_local()[0] - flight.true_local()[0]))
    speed_mps = flight.pilot.truth().v_ned_mps[0]
    delay_s = flight.pilot.parameters["VISO_DELAY_MS"] / 1000
    assert speed_mps > 8.0
    assert statistics.fmean(ahead) == pytest.approx((early_s + delay_s) * speed_mps, abs=0.25)


def test_the_present_follows_with_its_time_constant_and_loses_nothing() -> None:
    due = Due(OutputTaus(0.25, 0.25))
    due.p, due.v = 1.0, 0.0
    got = [due.step(0.01)[0] for _ in range(500)]
    assert sum(got[:25]) == pytest.approx(1 - math.exp(-1), abs=0.04)
    assert sum(got) == pytest.approx(1.0, abs=0.08)
    at_once = Due(OutputTaus())
    at_once.p, at_once.v = 1.0, 2.0
    assert at_once.step(0.01) == pytest.approx((1.02, 2.0))


def test_time_constants_are_the_autopilots_own() -> None:
    assert output_taus({"EK3_TAU_OUTPUT": 25}) == OutputTaus(0.25, 0.25)
    assert output_taus({"EKF2_TAU_POS": 0.1, "EKF2_TAU_VEL": 0.2}) == OutputTaus(0.1, 0.2)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_a_copter_keeps_its_speed_against_its_drag_round_corners(model: VehicleModel) -> None:
    corners = [(0.0, 0.0, -60.0), (200.0, 0.0, -60.0), (200.0, 200.0, -60.0), (0.0, 200.0, -60.0)]
    pilot = BuiltInAutopilot(AutopilotKind.PX4, "copter", HOME, corners, 8.0, 1, wind_ned_mps=(1.0, -1.0, 0.0), model=model)
    speeds = []
    for _ in range(900):
        pilot.step(0.1)
        speeds.append(math.hypot(*pilot.truth().v_ned_mps[:2]))
    assert max(speeds) < 9.5
    assert statistics.median(speeds[50:]) > 7.0


@pytest.mark.parametrize(("model", "bank_deg"), [(USUAL, 40.0), (ARDUPILOT_SITL, 65.0), (PX4_SIH, 50.0)], ids=MODELS)
def test_a_plane_banks_in_sharp_turns_as_far_as_its_autopilot_lets_it(model: VehicleModel, bank_deg: float) -> None:
    corners = [(0.0, 0.0, -100.0), (600.0, 0.0, -100.0), (0.0, 60.0, -100.0)]
    pilot = BuiltInAutopilot(AutopilotKind.PX4, "plane", HOME, corners, 26.0, 1, model=model)
    most = 0.0
    for _ in range(900):
        pilot.step(0.1)
        most = max(most, abs(pilot.flight.body.roll))
    assert math.degrees(most) == pytest.approx(bank_deg, abs=2.0)
