"""The simulated autopilot's MAVLink: streams, commands, parameters, time, and what bad input does."""

import math
import random
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.geo.se3 import angle_between, euler_from_quat
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo
from visloc_companion.sim import faults
from visloc_companion.sim.autopilot import BuiltInAutopilot
from visloc_companion.sim.autopilots.autopilot_clock import JitterCorrection, Px4Timesync
from visloc_companion.types import AutopilotKind, GeoPoint

HOME = GeoPoint(47.3977, 8.5456, 488.0)
INTERVAL, REQUEST = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
ATTITUDE, LOCAL = mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
GLOBAL = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
KINDS = ["ardupilot", "px4"]


@pytest.mark.parametrize(
    ("kind", "unasked"),
    [("ardupilot", {"HEARTBEAT", "GPS_GLOBAL_ORIGIN"}), ("px4", {"HEARTBEAT", "GPS_GLOBAL_ORIGIN", "TIMESYNC"})],
)
def test_nothing_is_streamed_unasked(companion, kind, unasked):
    flight = companion(kind=kind, sending=False).fly(10.0)
    assert set(flight.heard) == unasked
    assert 10 <= flight.heard["HEARTBEAT"] <= 11
    assert flight.heard["GPS_GLOBAL_ORIGIN"] == 1


@pytest.mark.parametrize("kind", KINDS)
def test_streams_come_at_the_rate_asked_for_and_stop(companion, kind):
    flight = companion(kind=kind, sending=False)
    assert flight.command(INTERVAL, ATTITUDE, 20_000) == mavlink.MAV_RESULT_ACCEPTED
    assert flight.command(INTERVAL, GLOBAL, 100_000) == mavlink.MAV_RESULT_ACCEPTED
    flight.fly(10.0)
    assert flight.heard["ATTITUDE"] == pytest.approx(500, abs=3)
    assert flight.heard["GLOBAL_POSITION_INT"] == pytest.approx(100, abs=2)
    assert flight.command(INTERVAL, ATTITUDE, -1) == mavlink.MAV_RESULT_ACCEPTED
    before = flight.heard["ATTITUDE"]
    flight.fly(1.0)
    assert flight.heard["ATTITUDE"] == before


@pytest.mark.parametrize(
    ("kind", "vehicle", "interval_us", "result"),
    [
        ("ardupilot", "plane", 20_000, mavlink.MAV_RESULT_DENIED),
        ("ardupilot", "plane", 25_000, mavlink.MAV_RESULT_ACCEPTED),
        ("ardupilot", "copter", 20_000, mavlink.MAV_RESULT_ACCEPTED),
        ("px4", "plane", 20_000, mavlink.MAV_RESULT_ACCEPTED),
        ("ardupilot", "copter", -2, mavlink.MAV_RESULT_DENIED),
        ("px4", "copter", -2, mavlink.MAV_RESULT_ACCEPTED),
        ("px4", "copter", math.nan, mavlink.MAV_RESULT_DENIED),
    ],
)
def test_intervals_are_granted_as_each_autopilot_does(companion, kind, vehicle, interval_us, result):
    mission = [(0, 0, -100), (900, 0, -100)]
    assert (
        companion(kind=kind, vehicle=vehicle, mission=mission, speed_mps=25.0).command(INTERVAL, ATTITUDE, interval_us) == result
    )


def test_ardupilot_accepts_streams_before_it_is_ready_and_forgets_them(companion):
    flight = companion(sending=False, ready_s=3.0)
    assert flight.command(INTERVAL, ATTITUDE, 1e5) == mavlink.MAV_RESULT_ACCEPTED
    flight.fly(4.0)
    assert [text for _, text in flight.texts] == ["ArduPilot Ready"]
    assert "ATTITUDE" not in flight.heard
    flight.command(INTERVAL, ATTITUDE, 1e5)
    flight.fly(1.0)
    assert flight.heard["ATTITUDE"] >= 10


def test_each_autopilot_sends_its_own_estimator_message_only(companion):
    ekf, estimator = mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS
    results = {(kind, i): companion(kind=kind).command(INTERVAL, i, 5e5) for kind in KINDS for i in (ekf, estimator)}
    assert results["ardupilot", ekf] == results["px4", estimator] == mavlink.MAV_RESULT_ACCEPTED
    assert results["ardupilot", estimator] == results["px4", ekf] == mavlink.MAV_RESULT_FAILED


@pytest.mark.parametrize(("kind", "autopilot", "version"), [("ardupilot", 3, (4, 7)), ("px4", 12, (1, 17))])
def test_identity_and_version(companion, kind, autopilot, version):
    flight = companion(kind=kind, sending=False).fly(1.5)
    heartbeat = flight.last["HEARTBEAT"]
    assert (heartbeat.autopilot, heartbeat.type) == (autopilot, mavlink.MAV_TYPE_QUADROTOR)
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert flight.command(REQUEST, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == mavlink.MAV_RESULT_ACCEPTED
    number = flight.last["AUTOPILOT_VERSION"].flight_sw_version
    assert (number >> 24, number >> 16 & 0xFF) == version


def test_unknown_commands_and_messages_are_refused_not_ignored(companion):
    flight = companion()
    assert flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0) == mavlink.MAV_RESULT_UNSUPPORTED
    assert flight.command(REQUEST, 9999) == mavlink.MAV_RESULT_FAILED
    assert companion(kind="px4").command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2) == mavlink.MAV_RESULT_UNSUPPORTED


def test_messages_for_another_system_are_not_taken(companion):
    flight = companion()
    flight.send(mavlink.MAVLink_command_long_message(7, 1, INTERVAL, 0, ATTITUDE, 1e5, 0, 0, 0, 0, 0))
    assert "COMMAND_ACK" not in flight.heard


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_streamed_is_the_truth_within_its_errors(companion, kind):
    flight = companion(kind=kind, sending=False)
    for message_id in (ATTITUDE, LOCAL, GLOBAL, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION):
        flight.command(INTERVAL, message_id, 1e4 if kind == "px4" else 2e4)
    flight.fly(15.0)
    truth, last = flight.pilot.truth(), flight.last
    q = last["ATTITUDE_QUATERNION"]
    assert math.degrees(angle_between((q.q1, q.q2, q.q3, q.q4), truth.q_ned_frd)) < 4.0
    roll, pitch, _ = euler_from_quat(truth.q_ned_frd)
    assert last["ATTITUDE"].roll == pytest.approx(roll, abs=0.03)
    assert last["ATTITUDE"].pitch == pytest.approx(pitch, abs=0.03)
    place = last["GLOBAL_POSITION_INT"]
    assert place.lat / 1e7 == pytest.approx(truth.place.lat_deg, abs=2e-5)
    assert place.relative_alt / 1000 == pytest.approx(40.0, abs=2.0)
    assert place.vx / 100 == pytest.approx(truth.v_ned_mps[0], abs=0.5)
    local = autopilot_ned_from_geo(AutopilotKind(kind), truth.place, HOME)
    assert (last["LOCAL_POSITION_NED"].x, last["LOCAL_POSITION_NED"].y) == pytest.approx(local[:2], abs=2.0)


def test_a_far_vehicle_has_the_local_coordinates_of_its_own_projection(companion):
    mission = [(3000.0, 3000.0, -100.0)]
    north = {}
    for kind in KINDS:
        flight = companion(kind=kind, mission=mission, sending=False).fly(2.0)
        north[kind] = flight.estimated_local()[0]
    assert north["ardupilot"] - 3000.0 == pytest.approx(3.4, abs=2.0)  # equatorial radius for every degree
    assert north["px4"] - 3000.0 == pytest.approx(0.3, abs=2.0)


def test_parameters_are_read_and_set_with_the_encoding_of_each(companion):
    flight = companion(kind="px4", sending=False)
    flight.send(mavlink.MAVLink_param_request_read_message(1, 1, b"EKF2_GPS_CTRL", -1))
    value = flight.last["PARAM_VALUE"]
    assert struct.unpack("<i", struct.pack("<f", value.param_value))[0] == 7
    assert value.param_type == mavlink.MAV_PARAM_TYPE_INT32
    flight.set_px4_integer("EKF2_GPS_CTRL", 0)
    assert flight.pilot.parameters["EKF2_GPS_CTRL"] == 0
    flight = companion(kind="ardupilot", sending=False)
    flight.send(mavlink.MAVLink_param_set_message(1, 1, b"VISO_POS_M_NSE", 0.5, mavlink.MAV_PARAM_TYPE_REAL32))
    assert flight.last["PARAM_VALUE"].param_value == pytest.approx(0.5)
    assert flight.pilot.parameters["VISO_POS_M_NSE"] == pytest.approx(0.5)
    flight.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 0))
    assert flight.last["PARAM_VALUE"].param_id == "VISO_TYPE"
    heard = flight.heard["PARAM_VALUE"]
    flight.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    flight.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 999))
    assert flight.heard["PARAM_VALUE"] == heard


def test_timesync_requests_are_answered_with_the_boot_clock(companion):
    flight = companion(sending=False, boot_age_s=12.5).fly(2.0)
    flight.send(mavlink.MAVLink_timesync_message(0, 424242))
    answer = flight.last["TIMESYNC"]
    assert answer.ts1 == 424242
    assert answer.tc1 == flight.pilot.t_boot_ns == 14_500_000_000


def test_sys_status_keeps_the_gps_bit_healthy_without_a_fix(companion):
    flight = companion(faults=faults.jam(2.0), sending=False)
    flight.command(INTERVAL, mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1e5)
    flight.fly(5.0)
    health = flight.last["SYS_STATUS"].onboard_control_sensors_health
    assert health & mavlink.MAV_SYS_STATUS_SENSOR_GPS
    assert not health & mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    flight.sending = True
    flight.fly(1.0)
    assert flight.last["SYS_STATUS"].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION


def test_global_vision_is_local_metres_on_ardupilot_and_nothing_on_px4(companion):
    for kind, taken in (("ardupilot", True), ("px4", False)):
        flight = companion(kind=kind, sending=False).fly(1.0)
        flight.send(mavlink.MAVLink_global_vision_position_estimate_message(1000, 1.0, 2.0, -40.0, 0, 0, 0))
        assert bool(flight.pilot.flight.estimator._external) is taken


def test_garbage_and_absurd_values_neither_raise_nor_stop_the_stream(companion):
    rng = random.Random(7)
    for kind in KINDS:
        flight = companion(kind=kind, faults=faults.jam(1.0), sending=False)
        for message_id in (LOCAL, GLOBAL, ATTITUDE):
            flight.command(INTERVAL, message_id, 1e5)
        flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
        for i in range(60):
            flight.pilot.receive(rng.randbytes(rng.randrange(300)))
            numbers = [rng.choice([1e30, -3e38, math.inf, math.nan, 5.0]) for _ in range(6)]
            flight.send(mavlink.MAVLink_vision_position_estimate_message(rng.getrandbits(64), *numbers, [1e30] * 21, i % 256))
            flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 2_000_000_000, 2_000_000_000, 0))
            flight.send(mavlink.MAVLink_param_set_message(1, 1, b"EKF2_EVP_GATE", math.nan, 9))
            flight.fly(0.1)
        assert flight.heard["ATTITUDE"] >= 55
        assert math.isfinite(flight.pilot.truth().p_ned_m[0])


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    def stream(seed):
        pilot = BuiltInAutopilot(
            AutopilotKind.PX4, "copter", HOME, [(0, 0, -50), (90, 0, -50)], 8.0, seed, wind_ned_mps=(4.0, 0, 0)
        )  # fmt: skip
        asking = mavlink.MAVLink(None, srcSystem=1, srcComponent=197)
        pilot.receive(mavlink.MAVLink_command_long_message(1, 1, INTERVAL, 0, LOCAL, 1e5, 0, 0, 0, 0, 0).pack(asking))
        pilot.step(5.0)
        return pilot.outgoing()

    assert stream(3) == stream(3)
    assert stream(3) != stream(4)


def test_the_size_of_the_steps_does_not_matter():
    fine, coarse = (BuiltInAutopilot(AutopilotKind.ARDUPILOT, "copter", HOME, [(0, 0, -50), (90, 0, -50)], 8.0, 1) for _ in "ab")
    for _ in range(1000):
        fine.step(0.007)
    coarse.step(7.0)
    assert fine.truth() == coarse.truth()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mission_ned_m": []}, "waypoint"),
        ({"speed_mps": 0.0}, "speed"),
        ({"kind": AutopilotKind.UNKNOWN}, "ardupilot or px4"),
        ({"parameters": {"NO_SUCH": 1}}, "NO_SUCH"),
        ({"vehicle": "plane", "start_airborne": False}, "air"),
    ],
)
def test_a_flight_that_cannot_be_flown_is_refused_with_the_reason(change, words):
    plan = {
        "kind": AutopilotKind.PX4,
        "vehicle": "copter",
        "home": HOME,
        "mission_ned_m": [(0, 0, -50)],
        "speed_mps": 8.0,
        "seed": 1,
    }
    with pytest.raises(ValueError, match=words):
        BuiltInAutopilot(**(plan | change))


def test_jitter_correction_takes_the_quickest_message_as_reference():
    clock = JitterCorrection()
    assert clock.correct(100.0, 5.30) == pytest.approx(5.30)
    assert clock.correct(100.1, 5.35) == pytest.approx(5.35)  # quicker: the new reference
    assert clock.correct(100.2, 5.75) == pytest.approx(5.45)  # 300 ms late


def test_a_clock_that_steps_back_reads_as_half_a_second_of_lag():
    clock = JitterCorrection()
    clock.correct(100.0, 5.0)
    assert clock.correct(90.0, 5.1) == pytest.approx(5.1 - 0.5)


def test_px4_timesync_needs_quick_replies_and_starts_anew_after_bad_ones():
    sync = Px4Timesync()
    for i in range(500):
        sync.reply(i * 0.1, i * 0.1 + 70.002, i * 0.1 + 0.004)
    assert sync.converged
    assert sync.convert(170.0, 105.0) == pytest.approx(100.0, abs=1e-3)
    for i in range(11):
        sync.reply(60.0 + i, 130.0 + i, 60.02 + i)
    assert not sync.converged
    assert sync.convert(170.0, 105.0) == 105.0
