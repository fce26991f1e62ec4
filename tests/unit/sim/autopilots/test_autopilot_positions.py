"""Every output in closed loop with the built-in autopilot that takes it, and what autopilots do not take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.adapters.mavlink.outputs.encoding import encode
from visloc_companion.adapters.mavlink.outputs.kinds import Output, Vehicle
from visloc_companion.adapters.mavlink.session import MavlinkSession
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.core.navigator import Navigator
from visloc_companion.core.settings import CoreSettings, InjectionSettings
from visloc_companion.geo.wgs84 import geo_from_autopilot_ned
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.estimators.estimator_ardupilot import position_error_m
from visloc_companion.sim.flight import ClosedLoopFlight, Eyes
from visloc_companion.types import AutopilotKind, GeoPoint, Injection

HOME = GeoPoint(47.4, 8.55, 480.0)
ARDUPILOT, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
JAM_S, END_S = 6.0, 32.0
VPE, ODOMETRY, SENSOR, RECEIVER, ESTIMATE = Output
BY_RECEIVER = {"GPS2_TYPE": 14, "EK3_SRC2_POSXY": 3, "EK3_SRC2_VELXY": 3}
BY_SENSOR = {"EKF2_EV_CTRL": 0, "EKF2_AGP0_ID": 1, "EKF2_AGP0_CTRL": 1}
DEAD_RECKONING = {"VISO_TYPE": 0, "EK3_SRC2_POSXY": 0}


@dataclass(frozen=True)
class Flown:
    chosen: Output | None
    p95_m: float
    failsafe: str | None


def fly(kind: AutopilotKind, vehicle: Any, changes: Mapping[str, float], eyes: Eyes, wanted: Output | None = None) -> Flown:
    """Jammed soon, then for half a minute on what is sent; the error is that of the autopilot's own estimate."""
    speed_mps = 25.0 if vehicle == "plane" else 10.0
    course = [(0, 0, -100), (400, 0, -100), (400, 400, -100), (0, 400, -100)]
    pilot = BuiltInAutopilot(kind, vehicle, HOME, course, speed_mps, 1, faults.jam(JAM_S), (2.0, -1.0, 0.0), parameters=changes)
    navigator = Navigator(CoreSettings(structure=False, injection=InjectionSettings(switch_source=True)))
    session = MavlinkSession(SessionSettings(output=wanted))
    log = ClosedLoopFlight(pilot, navigator, session, eyes).run(END_S)
    begun_ns = log.truth[0].t_ns + round((JAM_S + 7.0) * 1e9)
    errors_m = [sample.off_m for sample in log.truth if sample.t_ns > begun_ns and sample.off_m is not None]
    return Flown(session.choice.output, float(np.percentile(errors_m, 95)), log.failsafe)


@pytest.mark.parametrize(
    ("kind", "vehicle", "changes", "expected", "limit_m"),
    [
        (ARDUPILOT, "copter", {}, VPE, 3.0),
        (ARDUPILOT, "copter", {"VISO_QUAL_MIN": 30}, ODOMETRY, 3.0),
        (PX4, "copter", {"EKF2_EV_QMIN": 30}, ODOMETRY, 3.0),
        (PX4, "copter", BY_SENSOR, SENSOR, 4.0),
        (ARDUPILOT, "copter", BY_RECEIVER, RECEIVER, 4.0),
        (ARDUPILOT, "plane", DEAD_RECKONING, ESTIMATE, 6.0),
    ],
)
def test_a_vehicle_flies_on_the_output_that_it_is_prepared_for(
    oracle_eyes: Callable[..., Eyes],
    kind: AutopilotKind,
    vehicle: str,
    changes: dict[str, float],
    expected: Output,
    limit_m: float,
) -> None:
    flown = fly(kind, vehicle, changes, oracle_eyes())
    assert flown.chosen is expected
    assert flown.failsafe is None
    assert flown.p95_m < limit_m


def test_a_plane_is_further_off_without(oracle_eyes: Callable[..., Eyes]) -> None:
    """Else the flight with MAV_CMD_EXTERNAL_POSITION_ESTIMATE would show nothing."""
    alone = fly(ARDUPILOT, "plane", DEAD_RECKONING, oracle_eyes(misses=1.0))
    assert alone.p95_m > 2 * fly(ARDUPILOT, "plane", DEAD_RECKONING, oracle_eyes()).p95_m


def pose(**changes: Any) -> Any:
    values: dict[str, Any] = {
        "time_usec": 1_000_000,
        "frame_id": mavlink.MAV_FRAME_LOCAL_FRD,
        "child_frame_id": mavlink.MAV_FRAME_BODY_FRD,
        "x": 5.0,
        "y": 0.0,
        "z": -40.0,
        "q": [1.0, 0.0, 0.0, 0.0],
        **dict.fromkeys(("vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"), 0.0),
        "pose_covariance": [1.0] * 21,
        "velocity_covariance": [1.0] * 21,
        "estimator_type": mavlink.MAV_ESTIMATOR_TYPE_VISION,
        "quality": 80,
    }
    return mavlink.MAVLink_odometry_message(**(values | changes))


def taken(kind: AutopilotKind, message: Any, **changes: float) -> bool:
    pilot = BuiltInAutopilot(kind, "copter", HOME, [(0, 0, -40)], 5.0, 1, parameters=changes)
    pilot.step(1.0)
    before = len(pilot.flight.estimator._external)
    pilot.receive(message.pack(mavlink.MAVLink(None, 1, 197)))
    return len(pilot.flight.estimator._external) > before


NED, FRD = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD


@pytest.mark.parametrize(
    ("kind", "change", "parameters", "expected"),
    [
        (ARDUPILOT, {}, {}, True),
        (ARDUPILOT, {"frame_id": NED}, {}, False),
        (ARDUPILOT, {"child_frame_id": NED}, {}, False),
        (ARDUPILOT, {"quality": 30}, {"VISO_QUAL_MIN": 50}, False),
        (ARDUPILOT, {"quality": -1}, {}, False),
        (ARDUPILOT, {}, {"VISO_TYPE": 0}, False),
        (PX4, {"frame_id": NED, "child_frame_id": NED}, {}, True),
        (PX4, {"frame_id": FRD}, {}, False),
        (PX4, {"frame_id": NED, "estimator_type": mavlink.MAV_ESTIMATOR_TYPE_GPS}, {}, False),
        (PX4, {"frame_id": NED, "quality": 30}, {"EKF2_EV_QMIN": 50}, False),
    ],
)
def test_odometry_is_taken_in_one_frame_and_with_quality_enough(kind, change, parameters, expected):
    assert taken(kind, pose(**change), **parameters) is expected


def estimate(**changes: Any) -> Any:
    values = {"frame": mavlink.MAV_FRAME_GLOBAL, "z": math.nan, **changes}
    x, y = round(HOME.lat_deg * 1e7), round(HOME.lon_deg * 1e7)
    return mavlink.MAVLink_command_int_message(1, 1, values["frame"], 43003, 0, 0, 1.0, 0.0, 2.0, 0.0, x, y, values["z"])


def test_a_position_estimate_is_refused_while_gnss_is_fused_and_with_an_altitude(companion):
    flying = companion(
        "ardupilot", "plane", sending=False, mission=[(0, 0, -100), (600, 0, -100), (600, 600, -100)], speed_mps=25.0
    )
    flying.fly(2.0)
    for message, result in (
        (estimate(), mavlink.MAV_RESULT_FAILED),
        (estimate(z=480.0), mavlink.MAV_RESULT_DENIED),
        (estimate(frame=mavlink.MAV_FRAME_LOCAL_NED), mavlink.MAV_RESULT_DENIED),
    ):
        flying.send(message)
        assert (flying.last["COMMAND_ACK"].command, flying.last["COMMAND_ACK"].result) == (43003, result)


def test_a_receiver_without_velocity_is_unusable(companion):
    jammed = companion("ardupilot", sending=False, faults=faults.jam(2.0), parameters=BY_RECEIVER)
    x, y = round(HOME.lat_deg * 1e7), round(HOME.lon_deg * 1e7)
    ignored = mavlink.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ | mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT

    def play() -> None:
        message = mavlink.MAVLink_gps_input_message(0, 1, ignored, 0, 0, 3, x, y, 528.0, 1, 1, 0, 0, 0, 0.3, 1.0, 2.0, 10)
        jammed.send(message)

    jammed.fly(20.0, watch=play)
    assert jammed.pilot.failsafe is not None or jammed.max_m(10.0) > 20.0


def believed_sigma_m(kind: AutopilotKind, message: Any, changes: Mapping[str, float]) -> tuple[float, float]:
    """North and east 1-sigma that the autopilot reads out of a message, whatever it then does with it."""
    pilot = BuiltInAutopilot(kind, "copter", HOME, [(0, 0, -40)], 5.0, 1, faults.jam(0.0), parameters=changes, origin=HOME)
    pilot.receive(message.pack(mavlink.MAVLink(None, 1, 197)))
    estimator = pilot.flight.estimator
    if message.get_type() == "GLOBAL_POSITION_SENSOR":
        return (estimator._auxiliary[-1].sigma_m,) * 2
    if message.get_type() == "GPS_INPUT":
        return (estimator._gnss[-1].sample.h_acc_m,) * 2
    variances = estimator._external[-1].var_ned_m2
    if kind is ARDUPILOT:
        return (position_error_m(variances, 0.01)[0],) * 2
    return math.sqrt(variances[0]), math.sqrt(variances[1])


@pytest.mark.parametrize("sigmas_m", [(0.5, 0.5), (3.0, 1.0), (0.7, 20.0)])
@pytest.mark.parametrize(
    ("kind", "output", "changes"),
    [
        (ARDUPILOT, VPE, {}),
        (ARDUPILOT, ODOMETRY, {}),
        (ARDUPILOT, RECEIVER, BY_RECEIVER),
        (PX4, VPE, {}),
        (PX4, ODOMETRY, {}),
        (PX4, SENSOR, BY_SENSOR),
    ],
)
def test_the_autopilot_believes_the_sigma_that_is_meant(kind, output, changes, sigmas_m):
    (north_m, east_m), p_ned_m = sigmas_m, (10.0, -20.0, -40.0)
    cov = ((north_m**2, 0.0), (0.0, east_m**2))
    place = geo_from_autopilot_ned(kind, p_ned_m, HOME)
    velocity, cov_v = (1.0, 2.0, 0.0), ((0.1, 0.0), (0.0, 0.1))
    what = Injection(10**9, p_ned_m, place, (1.0, 0.0, 0.0, 0.0), cov, 3.0, 0.1, 0, velocity, cov_v)
    message = encode(output, what, Vehicle(kind, 1))
    believed = believed_sigma_m(kind, message, changes)
    per_axis = kind is PX4 and output is not SENSOR
    assert believed == pytest.approx(sigmas_m if per_axis else (max(sigmas_m),) * 2, rel=0.05)
