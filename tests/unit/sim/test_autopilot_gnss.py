"""What spoofing, jamming and boots without GNSS do to the simulated autopilots."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.core.satellites.gnss_height import pressure_altitude_m
from visloc_companion.sim import faults
from visloc_companion.types import GeoPoint

GLITCH = 0x8000


def watched(flight, duration_s, since_s):
    """Fly and return when each set of flags was first seen, seconds after a time."""
    seen = {}
    flight.fly(duration_s, lambda: seen.setdefault(flight.pilot.flight.health().flags, flight.pilot.t_s - since_s))
    return seen


def test_a_slow_position_drag_pulls_28_m_in_30_s_without_a_flag(companion):
    flight = companion(faults=faults.slow_drag(20.0, 1.0, 0.0, consistent_velocity=False), sending=False).fly(20.0)
    seen = watched(flight, 30.0, 20.0)
    assert list(seen) == [0x33F]
    assert flight.error_m[-1][1] == pytest.approx(28.0, abs=1.0)
    assert flight.pilot.pulled_m == pytest.approx(28.0, abs=1.0)
    assert flight.pilot.flight.health().position_ratio < 1.0


def test_a_fast_position_drag_is_a_glitch_at_first_and_believed_later(companion):
    flight = companion(faults=faults.slow_drag(20.0, 5.0, 0.0, consistent_velocity=False), sending=False).fly(20.0)
    seen = watched(flight, 10.0, 20.0)
    assert 2.0 <= seen[0x33F | GLITCH] <= 2.8
    assert flight.error_m[-1][1] < 3.0
    flight.fly(2.0)
    assert flight.first_s(20.0, 45.0) == pytest.approx(11.0, abs=0.8)
    assert flight.pilot.failsafe is None


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_consistent_drag_is_followed_fully_and_the_vehicle_goes_the_other_way(companion, kind):
    flight = companion(
        kind=kind, faults=faults.slow_drag(10.0, 1.0, 0.0), sending=False, mission=[(0, 0, -40)]
    )  # fmt: skip
    flight.fly(40.0)
    assert flight.pilot.truth().p_ned_m[0] == pytest.approx(-30.0, abs=3.0)
    assert flight.pilot.pulled_m == pytest.approx(30.0, abs=1.0)
    assert flight.pilot.failsafe is None


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_gnss_that_is_false_from_the_start_is_what_the_autopilot_begins_with(companion, kind):
    """It began at the true place instead, which nobody had told it, kept that against its receiver for 7 to 11 s, and spoke of a
    glitch."""
    schedule = faults.step_spoof(0.0, (0.0, 60.0, 0.0)) + faults.slow_drag(-10.0, 0.5, 0.0)
    flight = companion(kind=kind, faults=schedule, sending=False, mission=[(0, 0, -40)])
    assert flight.pilot.pulled_m == 0.0
    seen = watched(flight, 15.0, 0.0)
    assert len(seen) == 1
    assert min(error_m for _, error_m in flight.error_m) > 59.0
    north_m, east_m, _ = flight.pilot.truth().p_ned_m
    assert (north_m, east_m) == pytest.approx((-12.5, -60.0), abs=3.0)
    assert flight.pilot.pulled_m == pytest.approx(math.hypot(12.5, 60.0), abs=1.0)


def test_pulled_is_zero_without_spoofing_whatever_vision_says(companion):
    flight = companion(faults=faults.jam(15.0)).fly(10.0)
    flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
    flight.offset_m = (40.0, 0.0)
    flight.fly(20.0)
    assert flight.error_m[-1][1] > 30.0
    assert flight.pilot.pulled_m == 0.0


def test_a_step_of_gnss_is_believed_after_the_time_out(companion):
    flight = companion(faults=faults.step_spoof(10.0, (0.0, 60.0, 0.0)), sending=False).fly(25.0)
    assert 9.0 <= flight.first_s(10.0, 50.0) <= 11.0
    assert flight.pilot.pulled_m == pytest.approx(60.0, abs=2.0)


def test_gnss_that_comes_back_wrong_is_taken_at_once_by_px4(companion):
    flight = companion(kind="px4", faults=faults.gnss_returns_bad(10.0, 22.0, (80.0, 0.0, 0.0)), sigma_m=0.5).fly(22.0)
    assert flight.pilot.source == "external"
    assert flight.error_m[-1][1] < 3.0
    flight.fly(6.0)
    assert flight.pilot.source == "gnss"
    assert flight.error_m[-1][1] == pytest.approx(80.0, abs=3.0)


@pytest.mark.parametrize(("kind", "eph", "h_acc_mm"), [("ardupilot", 121, 400), ("px4", 10000, 100000)])
def test_gps_raw_int_shows_the_loss_within_half_a_second(companion, kind, eph, h_acc_mm):
    flight = companion(kind=kind, faults=faults.jam(5.0), sending=False)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2e5)
    flight.fly(4.9)
    good = flight.last["GPS_RAW_INT"]
    assert (good.fix_type, good.satellites_visible, good.h_acc) == (6, 10, 400)
    flight.fly(0.6)
    lost = flight.last["GPS_RAW_INT"]
    assert (lost.fix_type, lost.satellites_visible, lost.eph, lost.h_acc) == (1, 3, eph, h_acc_mm)
    assert flight.pilot.gnss_reported() is None


def test_gps_raw_int_reports_the_false_place(companion):
    flight = companion(faults=faults.step_spoof(1.0, (0.0, 100.0, 0.0)), sending=False, mission=[(0, 0, -40)])
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2e5)
    flight.fly(3.0)
    raw, true = flight.last["GPS_RAW_INT"], flight.pilot.truth().place
    east_m = (raw.lon / 1e7 - true.lon_deg) * 111320 * math.cos(math.radians(true.lat_deg))
    assert east_m == pytest.approx(100.0, abs=3.0)
    assert flight.pilot.gnss_reported().lon_deg == pytest.approx(raw.lon / 1e7, abs=1e-6)


def test_a_false_height_beyond_the_field_is_held_within_it(companion):
    """2,147 km in millimetres of 32 bits."""
    flight = companion(faults=faults.step_spoof(1.0, (0.0, 0.0, -3e6)), sending=False)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2e5)
    assert flight.fly(2.0).last["GPS_RAW_INT"].alt == 2**31 - 1


def test_ardupilot_without_gnss_waits_for_an_origin_and_takes_only_the_first(companion):
    flight = companion(faults=faults.no_gnss(), latency_s=0.02).fly(3.0)
    for message_id in (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT):
        flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e5)
    assert flight.pilot.mode == "by_hand"
    assert flight.pilot.estimate() is None
    flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
    flight.fly(3.0)
    assert flight.last["EKF_STATUS_REPORT"].flags & 0x10  # POS_HORIZ_ABS, though it knows no origin
    position = flight.last["GLOBAL_POSITION_INT"]
    assert (position.lat, position.lon, position.alt) == (0, 0, 0)
    assert position.relative_alt / 1e3 == pytest.approx(40.0, abs=1.5)
    assert "GPS_GLOBAL_ORIGIN" not in flight.heard
    flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977000, 85456000, 488000))
    flight.fly(25.0)
    assert flight.pilot.mode == "mission"
    assert flight.rms_m(12.0) < 1.0
    flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 470000000, 80000000, 0))
    assert flight.last["GPS_GLOBAL_ORIGIN"].latitude == 473977000
    assert flight.pilot.flight.origin == GeoPoint(47.3977, 8.5456, 488.0)


def test_px4_moves_its_origin_in_flight_and_stays_where_it_is(companion):
    flight = companion(kind="px4", sending=False).fly(10.0)
    flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473987000, 85456000, 468000))
    flight.fly(5.0)
    assert flight.last["GPS_GLOBAL_ORIGIN"].latitude == 473987000
    true = flight.pilot.truth().place
    assert flight.pilot.estimate().lat_deg == pytest.approx(true.lat_deg, abs=2e-5)
    assert flight.pilot.estimate().h_amsl_m == pytest.approx(true.h_amsl_m, abs=2.0)
    assert flight.estimated_local()[2] == pytest.approx(468.0 - true.h_amsl_m, abs=2.0)


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
@pytest.mark.parametrize("above_m", [0.0, 40.0, -488.0])
def test_a_first_origin_is_what_ardupilot_knows_of_its_height_above_the_sea(companion, kind, above_m):
    """As in the makers' simulators: ArduPilot's is wrong by what the station told wrong (0, say), PX4's is its barometer's.

    Neither flight nor air pressure change, nor do readings that wait to be fused know of it: the height was 28 m off for seconds.
    """
    flight = companion(kind=kind, faults=faults.no_gnss(), sending=False)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 1e5)
    flight.fly(3.0)
    altitude_m = pressure_altitude_m(flight.last["SCALED_PRESSURE"].press_abs)
    flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977000, 85456000, round(488000 + above_m * 1e3)))
    off_m: list[float] = []
    flight.fly(3.0, lambda: off_m.append(flight.pilot.estimate().h_amsl_m - flight.pilot.truth().place.h_amsl_m))
    wrong_m = above_m if kind == "ardupilot" else 0.0
    assert (min(off_m), max(off_m)) == pytest.approx((wrong_m, wrong_m), abs=1.5)
    assert flight.estimated_local()[2] == pytest.approx(-40.0 if kind == "ardupilot" else above_m - 40.0, abs=1.5)
    assert -flight.pilot.truth().p_ned_m[2] == pytest.approx(40.0, abs=1.5)
    assert pressure_altitude_m(flight.last["SCALED_PRESSURE"].press_abs) == pytest.approx(altitude_m, abs=1.5)
    if kind == "ardupilot":
        flight.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
        told = flight.last["GLOBAL_POSITION_INT"]
        assert told.alt / 1e3 == pytest.approx(528.0 + above_m, abs=1.5)
        assert told.relative_alt / 1e3 == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize(("kind", "wrong_m"), [("ardupilot", 50.0), ("px4", 0.0)])
def test_a_height_that_gnss_falsifies_from_the_start_stays_that_much_wrong(companion, kind, wrong_m):
    flight = companion(kind=kind, faults=faults.step_spoof(0.0, (0.0, 0.0, -50.0), end_s=5.0), sending=False).fly(10.0)
    true = flight.pilot.truth()
    assert flight.pilot.estimate().h_amsl_m - true.place.h_amsl_m == pytest.approx(wrong_m, abs=1.5)
    assert -true.p_ned_m[2] == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_flight_that_began_without_a_position_has_no_drift_between_filter_and_predictor(companion, kind):
    """The hold without aiding once left the present velocity apart from the delayed one for good."""
    flight = companion(kind=kind, faults=faults.no_gnss(), sigma_m=0.05, latency_s=0.02, origin=GeoPoint(47.3977, 8.5456, 488.0))
    flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
    flight.fly(60.0)
    assert flight.pilot.mode == "mission"
    assert flight.rms_m(40.0) < 0.6


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_copter_on_the_ground_takes_off_when_it_has_a_position(companion, kind):
    flight = companion(kind=kind, start_airborne=False, sending=False)
    assert flight.pilot.truth().p_ned_m == (0.0, 0.0, 0.0)
    flight.fly(25.0)
    assert flight.pilot.mode == "mission"
    assert -flight.pilot.truth().p_ned_m[2] == pytest.approx(40.0, abs=3.0)


def test_a_jam_without_a_companion_drifts_the_copter_far_away(companion):
    flight = companion(faults=faults.jam(10.0), sending=False, mission=[(0, 0, -100)]).fly(110.0)
    assert math.hypot(*flight.pilot.truth().p_ned_m[:2]) > 100.0
    assert flight.pilot.failsafe is not None


def test_a_plane_without_gnss_circles_by_hand_until_vision_gives_it_a_position(companion):
    flight = companion(
        vehicle="plane", speed_mps=20.0, mission=[(0, 0, -100), (600, 0, -100)], faults=faults.no_gnss(), sending=False,
        latency_s=0.02,
    )  # fmt: skip
    flight.fly(20.0)
    assert flight.pilot.mode == "by_hand"
    assert -flight.pilot.truth().p_ned_m[2] == pytest.approx(100.0, abs=4.0)
    flight.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977000, 85456000, 488000))
    flight.command(mavlink.MAV_CMD_SET_EKF_SOURCE_SET, 2)
    flight.sending = True
    flight.fly(30.0)
    assert flight.pilot.mode == "mission"
    assert flight.rms_m(35.0) < 2.0


def test_a_blind_landing_after_spoofing_does_not_count_as_pulled(companion):
    flight = companion(kind="px4", faults=faults.slow_drag(5.0, 1.0, 0.0, end_s=25.0) + faults.jam(25.0), sending=False)
    flight.fly(30.5)
    assert flight.pilot.mode == "land"
    pulled_m = flight.pilot.pulled_m
    assert pulled_m == pytest.approx(25.0, abs=2.0)  # 20 m while spoofed and 5 s of a velocity that is 1 m/s off
    flight.fly(30.0)
    assert flight.pilot.pulled_m == pulled_m


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_pressure_and_gnss_time_stand_beside_the_receiver(companion, kind):
    flight = companion(kind=kind, sending=False)
    for number in (mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME):
        assert flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6) == mavlink.MAV_RESULT_ACCEPTED
    flight.fly(5.0)
    height_m = pressure_altitude_m(flight.last["SCALED_PRESSURE"].press_abs)
    assert height_m == pytest.approx(flight.pilot.truth().place.h_amsl_m, abs=2.0)
    first = flight.last["SYSTEM_TIME"]
    flight.fly(4.0)
    last = flight.last["SYSTEM_TIME"]
    assert last.time_unix_usec - first.time_unix_usec == 1000 * (last.time_boot_ms - first.time_boot_ms)
    assert last.time_unix_usec > 1_700_000_000_000_000


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
@pytest.mark.parametrize(("jammed_s", "knows"), [((0.0, 3.0), [False, True]), ((4.0, 100.0), [True, True])])
def test_the_time_of_day_is_known_once_there_was_a_fix(companion, kind, jammed_s, knows):
    """An autopilot that never had a fix told the calendar time all the same."""
    flight = companion(kind=kind, faults=faults.jam(*jammed_s), sending=False)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1e6)
    told = [flight.fly(s).last["SYSTEM_TIME"].time_unix_usec for s in (2.0, 8.0)]
    assert [unix_us > 1_700_000_000_000_000 for unix_us in told] == knows
    assert told[0] == 0 or knows[0]
