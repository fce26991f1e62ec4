"""The simulated gimbal: what it does with the camera, and what the autopilots say of it."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.codec import decode
from visloc_companion.errors import ConfigError
from visloc_companion.geo.se3 import R_from_quat, angle_between, euler_from_quat, quat_from_euler, quat_multiply, rotate
from visloc_companion.sim import faults
from visloc_companion.sim.vehicle import Body
from visloc_companion.sim.vehicles.gimbal import GimbalPlan, SimulatedGimbal
from visloc_companion.types import GimbalAttitude, GimbalFrame, Quat

DT_S = 0.01
STEADY = GimbalPlan(shake_rad=0.0, tilt_rad=0.0, yaw_rad=0.0)
LOOKS_DOWN = quat_from_euler(0.0, math.pi / 2, 0.0)


def axis(q: Quat) -> tuple[float, float, float]:
    """Where a camera looks that is mounted straight."""
    return rotate(q, (0.0, 0.0, 1.0))


def run(plan: GimbalPlan, body: Body, seconds: float) -> SimulatedGimbal:
    gimbal = SimulatedGimbal(plan, Random(1), body)
    for k in range(round(seconds / DT_S)):
        gimbal.step(body, (k + 1) * DT_S, DT_S)
    return gimbal


def test_it_holds_the_camera_straight_down_whatever_the_vehicle_does() -> None:
    gimbal = run(STEADY, Body(roll=0.4, pitch=-0.3, yaw=2.0), 2.0)
    assert axis(gimbal.q_ned_body) == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    assert euler_from_quat(gimbal.q_ned_body)[2] == pytest.approx(2.0)


def test_its_joint_reaches_only_so_far() -> None:
    """Nose up by 50 degrees: beyond -125 against the airframe it leans with it."""
    gimbal = run(STEADY, Body(pitch=math.radians(50.0)), 1.0)
    tilt_deg = math.degrees(math.acos(axis(gimbal.q_ned_body)[2]))
    assert tilt_deg == pytest.approx(15.0)
    assert math.degrees(euler_from_quat(gimbal.said)[1]) == pytest.approx(-75.0), "and says so"


def test_it_follows_the_heading_late_and_says_its_yaw_against_it() -> None:
    gimbal, body = SimulatedGimbal(STEADY, Random(1), Body()), Body()
    for k in range(300):
        body.turn(0.0, 0.0, 0.5 * k * DT_S, DT_S)
        gimbal.step(body, k * DT_S, DT_S)
    heading, own = body.yaw, euler_from_quat(gimbal.q_ned_body)[2]
    assert heading - own == pytest.approx(0.5 * STEADY.follow_s, abs=0.01)
    said = quat_multiply(gimbal.said, LOOKS_DOWN)
    assert euler_from_quat(said)[2] == pytest.approx(own - heading, abs=0.01)
    assert gimbal.rate_radps == pytest.approx((0.0, 0.0, 0.5), abs=0.01)


def test_it_turns_where_it_is_told_and_says_so_late() -> None:
    plan = replace(STEADY, pitches_rad=((0.0, -math.pi / 2), (1.0, 0.0)))
    gimbal = run(plan, Body(), 1.5)
    assert math.degrees(math.atan2(axis(gimbal.q_ned_body)[0], axis(gimbal.q_ned_body)[2])) == pytest.approx(30.0, abs=1.0)
    late_deg = math.degrees(euler_from_quat(gimbal.said)[1]) + 90.0 - 30.0
    assert late_deg == pytest.approx(-math.degrees(plan.slew_radps) * plan.late_s, abs=1.2)
    assert math.degrees(gimbal.rate_radps[1]) == pytest.approx(60.0, abs=0.5)


def test_what_it_says_errs_as_planned() -> None:
    plan, body = GimbalPlan(tilt_s=1.0, yaw_s=1.0, late_s=0.0), Body()
    gimbal, off_rad = SimulatedGimbal(plan, Random(3), body), []
    for k in range(60_000):
        gimbal.step(body, k * DT_S, DT_S)
        if k % 50 == 0:
            said = R_from_quat(quat_multiply(gimbal.said, LOOKS_DOWN))
            off_rad.append((R_from_quat(gimbal.q_ned_body).T @ said)[:2, 2])
    sigma = float(np.std(np.array(off_rad)))
    assert sigma == pytest.approx(plan.tilt_rad, rel=0.12)


# ------------------------------------------------------------------------------------------------------------ autopilots


def heard(companion: Any, kind: str, **more: Any) -> Any:
    flight = companion(kind, sending=False, **more)
    flight.fly(1.0)
    assert flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 285, 40_000) == mavlink.MAV_RESULT_ACCEPTED
    before = flight.heard["GIMBAL_DEVICE_ATTITUDE_STATUS"]
    flight.fly(2.0)
    assert before == 0
    return flight


@pytest.mark.parametrize(("kind", "unstated"), [("ardupilot", math.nan), ("px4", 0.0)])
def test_the_autopilots_say_where_it_points(companion: Any, kind: str, unstated: float) -> None:
    flight = heard(companion, kind, gimbal=STEADY)
    assert flight.heard["GIMBAL_DEVICE_ATTITUDE_STATUS"] == pytest.approx(50, abs=2)
    message = flight.last["GIMBAL_DEVICE_ATTITUDE_STATUS"]
    assert (message.flags, message.gimbal_device_id) == (44, 1), "as ArduCopter's own simulator sends it"
    assert [message.delta_yaw, message.angular_velocity_x] == pytest.approx([unstated] * 2, nan_ok=True)
    (event,) = decode(message, 0)
    assert isinstance(event, GimbalAttitude)
    assert event.frame is GimbalFrame.HEADING
    heading = quat_from_euler(0.0, 0.0, flight.pilot.flight.body.yaw)
    body = quat_multiply(quat_multiply(heading, event.q_frame_gimbal), LOOKS_DOWN)
    assert math.degrees(angle_between(body, flight.pilot.camera_carrier()[0])) < 0.5


def test_without_a_gimbal_nothing_is_said_of_one_and_the_airframe_carries_the_camera(companion: Any) -> None:
    flight = heard(companion, "ardupilot")
    assert flight.heard["GIMBAL_DEVICE_ATTITUDE_STATUS"] == 0
    truth = flight.pilot.truth()
    assert flight.pilot.camera_carrier() == (truth.q_ned_frd, truth.rate_frd_radps)


def test_a_silent_gimbal_says_nothing(companion: Any) -> None:
    silent = faults.these(faults.GimbalSilence(1.5, 2.0))
    flight = heard(companion, "ardupilot", gimbal=STEADY, faults=silent)
    assert flight.heard["GIMBAL_DEVICE_ATTITUDE_STATUS"] == pytest.approx(38, abs=2)


def test_a_gimbal_changes_nothing_else_of_a_flight(companion: Any) -> None:
    """Its noise is drawn on its own."""
    without, held = (companion("ardupilot", sending=False, gimbal=plan).fly(10.0) for plan in (None, GimbalPlan()))
    assert without.pilot.truth() == held.pilot.truth()
    assert without.pilot.flight.attitude.euler(without.pilot.flight.body) == held.pilot.flight.attitude.euler(
        held.pilot.flight.body
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"pitches_rad": ()},
        {"pitches_rad": ((5.0, -1.5),)},
        {"pitches_rad": ((0.0, -1.5), (9.0, 0.0), (5.0, -1.0))},
        {"slew_radps": 0.0},
        {"follow_s": 0.0},
        {"joint_rad": (0.5, -2.0)},
    ],
)
def test_a_plan_that_no_gimbal_follows_is_refused(wrong: dict[str, Any]) -> None:
    """One that began at 5 s ended the flight at its first step."""
    with pytest.raises(ConfigError, match="GimbalPlan"):
        GimbalPlan(**wrong)
