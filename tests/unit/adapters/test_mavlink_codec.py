"""Messages to events: units, unknown values, MAVLink 1, values that must be dropped."""

import math

import pytest
from pymavlink.dialects.v10 import ardupilotmega as v10

from visloc_companion.adapters.mavlink.codec import decode, examine, version_text
from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.link_state import LinkState
from visloc_companion.errors import Reason
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    Baro,
    EstimatorStatus,
    GeoPoint,
    Gnss,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
    Range,
)

NAN, INF = float("nan"), float("inf")
T = 5_000_000_000


def one(msg):
    (event,) = decode(msg, T)
    assert event.t_rx_ns == T
    return event


@pytest.mark.parametrize("dialect", [mav, v10])
def test_attitude(dialect):
    event = one(dialect.MAVLink_attitude_message(1234, 0.1, -0.2, 3.0, 0.01, 0.02, 0.03))
    assert isinstance(event, Attitude)
    assert event.t_boot_ns == 1_234_000_000
    assert euler_from_quat(event.q_ned_frd) == pytest.approx((0.1, -0.2, 3.0))
    assert event.rate_frd_radps == pytest.approx((0.01, 0.02, 0.03))


def test_attitude_quaternion_is_normalised_and_w_positive():
    event = one(mav.MAVLink_attitude_quaternion_message(1, -0.7, 0.0, 0.0, -0.7, 0.1, 0.2, 0.3))
    assert event.q_ned_frd == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    assert examine(mav.MAVLink_attitude_quaternion_message(1, 0, 0, 0, 0, 0, 0, 0), T) is Reason.BAD_INPUT
    assert examine(mav.MAVLink_attitude_quaternion_message(1, NAN, 0, 0, 0, 0, 0, 0), T) is Reason.NOT_FINITE


def test_global_position():
    event = one(mav.MAVLink_global_position_int_message(2000, 473977000, -85456000, 488250, 12500, 310, -220, 45, 9000))
    assert event == PriorPose(T, 2_000_000_000, GeoPoint(47.3977, -8.5456, 488.25), (3.1, -2.2, 0.45), 12.5)


def test_a_global_position_of_zero_is_no_position():
    """Both autopilots report 0, 0 before the estimator has an origin."""
    msg = mav.MAVLink_global_position_int_message(2000, 0, 0, 488250, 0, 0, 0, 0, 0)
    assert decode(msg, T) == []
    assert examine(msg, T) is Reason.NO_ORIGIN
    beyond = mav.MAVLink_global_position_int_message(2000, 910000000, 0, 488250, 0, 0, 0, 0, 0)
    assert examine(beyond, T) is Reason.BAD_INPUT


def test_local_position():
    event = one(mav.MAVLink_local_position_ned_message(2000, 1.0, 2.0, -3.0, 4.0, 5.0, 6.0))
    assert event == LocalPose(T, 2_000_000_000, (1.0, 2.0, -3.0), (4.0, 5.0, 6.0))
    for bad in (NAN, INF):
        assert examine(mav.MAVLink_local_position_ned_message(2000, bad, 2.0, -3.0, 4.0, 5.0, 6.0), T) is Reason.NOT_FINITE


def test_gnss_with_accuracies_and_course():
    msg = mav.MAVLink_gps_raw_int_message(3_000_000, 3, 473977000, 85456000, 488000, 90, 120, 1000, 9000, 14, 0, 800, 1200, 1, 1)
    event = one(msg)
    assert isinstance(event, Gnss)
    assert (event.fix_type, event.n_satellites, event.h_acc_m, event.v_acc_m, event.receiver) == (3, 14, 0.8, 1.2, 0)
    assert event.v_ned_mps == pytest.approx((0.0, 10.0, 0.0), abs=1e-9)
    assert event.t_boot_ns == 3_000_000_000


def test_gnss_unknowns_are_none():
    event = one(mav.MAVLink_gps_raw_int_message(0, 1, 473977000, 85456000, 0, 65535, 65535, 65535, 65535, 255))
    assert (event.n_satellites, event.h_acc_m, event.v_acc_m, event.v_ned_mps) == (None, None, None, None)
    event = one(mav.MAVLink_gps_raw_int_message(0, 1, 473977000, 85456000, 0, 65535, 65535, 100, 65535, 9))
    assert event.v_ned_mps is None


def test_gnss_of_mavlink_1_has_no_accuracy():
    event = one(v10.MAVLink_gps_raw_int_message(3_000_000, 3, 473977000, 85456000, 488000, 90, 120, 0, 0, 14))
    assert (event.h_acc_m, event.v_acc_m, event.n_satellites) == (None, None, 14)


def test_gnss_without_fix_still_comes_with_its_fix_type():
    event = one(mav.MAVLink_gps_raw_int_message(5, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0))
    assert (event.fix_type, event.n_satellites) == (0, 0)


def test_gnss_time_since_1970_is_no_boot_time():
    event = one(mav.MAVLink_gps_raw_int_message(1_436_060_000_000_000, 3, 1, 1, 0, 65535, 65535, 65535, 65535, 9))
    assert event.t_boot_ns == 0


def test_the_second_receiver_is_numbered():
    msg = mav.MAVLink_gps2_raw_message(7, 3, 473977000, 85456000, 488000, 90, 120, 0, 0, 9, 0, 0, h_acc=700)
    event = one(msg)
    assert (event.receiver, event.h_acc_m, event.v_acc_m) == (1, 0.7, None)


def test_ekf_status_of_ardupilot():
    good = one(mav.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    assert good == EstimatorStatus(T, pytest.approx(0.2), pytest.approx(0.1), pytest.approx(0.3), True, False, None, None, True)
    assert not one(mav.MAVLink_ekf_status_report_message(0x25, 0.1, 0.2, 0.3, 0, 0)).horizontal_position_ok
    assert not one(mav.MAVLink_ekf_status_report_message(0xA7 | 16, 0.1, 0.2, 0.3, 0, 0)).horizontal_position_ok
    assert one(mav.MAVLink_ekf_status_report_message(0x833F, 0.1, 0.2, 0.3, 0, 0)).gnss_glitch


@pytest.mark.parametrize(("flags", "vouched"), [(0x33F, True), (0x12F, True), (0x25, False), (0xA7, False), (0, None)])
def test_ardupilot_vouches_for_its_velocity_but_not_while_it_holds_a_position(flags: int, vouched: bool | None) -> None:
    assert one(mav.MAVLink_ekf_status_report_message(flags, 0.1, 0.2, 0.3, 0, 0)).velocity_ok is vouched


@pytest.mark.parametrize(("flags", "position", "velocity"), [(0x3BF, True, True), (0x25, False, False), (0xA5, False, False)])
def test_px4_at_rest_has_a_position_if_it_says_so(flags: int, position: bool, velocity: bool) -> None:
    event = one(mav.MAVLink_estimator_status_message(1, flags, 0.1, 0.1, 0.1, 0, 0, NAN, 1.0, 1.0))
    assert (event.horizontal_position_ok, event.velocity_ok) == (position, velocity)


def test_estimator_status_of_px4():
    event = one(mav.MAVLink_estimator_status_message(1, 0x33F | 0x400, 0.1, 1.7, NAN, 0, 0, NAN, 1.0, 1.0))
    assert (event.position_ratio, event.velocity_ratio, event.height_ratio) == (1.7, 0.1, None)
    assert (event.horizontal_position_ok, event.gnss_glitch, event.gnss_in_use) == (True, True, True)
    assert one(mav.MAVLink_estimator_status_message(1, 0x13F, 0, 0, 0, 0, 0, 0, 0, 0)).gnss_in_use is False


def test_only_a_rangefinder_that_looks_down_counts():
    down = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 1234, 0, 0, mav.MAV_SENSOR_ROTATION_PITCH_270, 255)
    assert one(down) == Range(T, 1_000_000_000, 12.34, True)
    ahead = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 1234, 0, 0, 0, 255)
    assert decode(ahead, T) == []
    beyond = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 6000, 0, 0, mav.MAV_SENSOR_ROTATION_PITCH_270, 255)
    assert not one(beyond).valid
    lost = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 900, 0, 0, 25, 255, signal_quality=1)
    assert not one(lost).valid


@pytest.mark.parametrize(
    ("distance_cm", "quality", "valid"),
    [
        *((19, 0, False), (20, 0, True), (4999, 0, True), (5000, 0, False), (5100, 0, False), (65535, 0, False)),
        *((900, 0, True), (900, 1, False), (900, 2, True), (900, 100, True), (5000, 100, False)),
    ],
)
def test_the_end_of_a_rangefinders_reach_is_no_distance(distance_cm: int, quality: int, valid: bool) -> None:
    """Centimetres are cut off by both autopilots (GCS_Common.cpp, DISTANCE_SENSOR.hpp): 50.00 of 50 m is 50.00 to 50.01 m, and a
    simulated beam that meets nothing (Gazebo's) is as long as it may be. Quality 0 is unknown, 1 invalid, for both."""
    down = mav.MAV_SENSOR_ROTATION_PITCH_270
    said = mav.MAVLink_distance_sensor_message(1000, 20, 5000, distance_cm, 0, 0, down, 255, signal_quality=quality)
    assert one(said).valid is valid


def test_a_reach_beyond_what_the_message_holds_is_none_either() -> None:
    """65535 cm is all that fits: a reading there may be of anything farther."""
    said = mav.MAVLink_distance_sensor_message(1000, 20, 65535, 65535, 0, 0, mav.MAV_SENSOR_ROTATION_PITCH_270, 255)
    assert not one(said).valid


def test_a_rangefinder_says_which_it_is_and_how_it_scatters():
    down = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 1234, 0, 3, mav.MAV_SENSOR_ROTATION_PITCH_270, 25)
    assert one(down) == Range(T, 1_000_000_000, 12.34, True, 3, sigma_m=0.05)
    unknown = mav.MAVLink_distance_sensor_message(1000, 20, 5000, 1234, 0, 3, mav.MAV_SENSOR_ROTATION_PITCH_270, 0)
    assert one(unknown).sigma_m is None, "ArduPilot sends 0"


def test_rangefinder_and_pressure():
    assert one(mav.MAVLink_rangefinder_message(7.5, 0.0)) == Range(T, 0, 7.5, True)
    assert not one(mav.MAVLink_rangefinder_message(0.0, 0.0)).valid
    assert examine(mav.MAVLink_rangefinder_message(NAN, 0.0), T) is Reason.NOT_FINITE
    assert one(mav.MAVLink_scaled_pressure_message(1000, 955.5, 0.0, 2150)) == Baro(T, 1_000_000_000, 955.5, 21.5)
    assert examine(mav.MAVLink_scaled_pressure_message(1000, INF, 0.0, 2150), T) is Reason.NOT_FINITE


def test_origin():
    event = one(mav.MAVLink_gps_global_origin_message(473977000, 85456000, 488000))
    assert event == OriginChanged(T, GeoPoint(47.3977, 8.5456, 488.0))
    assert examine(mav.MAVLink_gps_global_origin_message(0, 0, 0), T) is Reason.NO_ORIGIN


def test_what_says_nothing_to_the_navigator_gives_nothing():
    assert decode(mav.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0), T) == []
    assert decode(mav.MAVLink_timesync_message(0, 1), T) == []


@pytest.mark.parametrize(
    ("packed", "text"),
    [(0x040603FF, "4.6.3"), (0x04070000, "4.7.0-dev"), (0x010F0040, "1.15.0-alpha"), (0x010F0080, "1.15.0-beta"),
     (0x010F00C0, "1.15.0-rc"), (0, "")],
)  # fmt: skip
def test_versions(packed, text):
    assert version_text(packed) == text


def heartbeat(autopilot: int, base_mode: int = 0):
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, autopilot, base_mode, 0, 4, 3)


def test_heartbeats_tell_kind_and_arming():
    assert one(heartbeat(mav.MAV_AUTOPILOT_PX4, 128)) == LinkChanged(T, True, AutopilotKind.PX4, "", 0, True)
    assert one(heartbeat(mav.MAV_AUTOPILOT_GENERIC)).autopilot is AutopilotKind.UNKNOWN
    assert decode(heartbeat(mav.MAV_AUTOPILOT_INVALID), T) == []


def test_link_state_passes_changes_only():
    state = LinkState()
    version = LinkChanged(1, True, version="4.6.3", system_id=1)
    beat = LinkChanged(2, True, AutopilotKind.ARDUPILOT, system_id=1)
    assert state.heard(version) is None
    assert state.heard(beat) == LinkChanged(2, True, AutopilotKind.ARDUPILOT, "4.6.3", 1)
    assert state.heard(beat) is None
    armed = state.heard(LinkChanged(3, True, AutopilotKind.ARDUPILOT, system_id=1, armed=True))
    assert armed is not None
    assert armed.armed
    assert state.heard(version) is None
    down = state.down(9)
    assert down is not None
    assert (down.up, down.t_rx_ns) == (False, 9)
    assert state.down(10) is None
