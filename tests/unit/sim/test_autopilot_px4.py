"""Figures that docs/px4.md states of the maker's simulator: the simulated PX4 must land near them."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.sim import faults
from visloc_companion.sim.vehicles.vehicle_model import PX4_SIH

NAN = math.nan


def fly_px4(companion, settle_s=8.0, **more):
    options = {"kind": "px4", "speed_mps": 6.0, "sigma_m": 0.5, "latency_s": 0.06} | more
    return companion(**options).fly(settle_s)


def gnss_off(flight):
    flight.set_px4_integer("EKF2_GPS_CTRL", 0)
    return flight.pilot.t_s


@pytest.mark.parametrize(("rate_hz", "starts"), [(2.0, False), (3.0, False), (5.5, True), (10.0, True), (20.0, True)])
def test_external_positions_start_only_with_two_within_200_ms(companion, rate_hz, starts):
    flight = fly_px4(companion, rate_hz=rate_hz)
    gnss_off(flight)
    flight.fly(15.0)
    assert (flight.pilot.source == "external") is starts
    assert (flight.pilot.failsafe is None) is starts
    if starts:
        assert flight.rms_m(10.0) < 1.0


def test_once_started_three_hertz_hold_and_two_do_not(companion):
    for rate_hz, holds in ((3.0, True), (2.0, False)):
        flight = fly_px4(companion)
        gnss_off(flight)
        flight.fly(3.0)
        flight.rate_hz = rate_hz
        flight.fly(12.0)
        assert (flight.pilot.failsafe is None) is holds


def test_nothing_is_fused_unless_ev_ctrl_says_so(companion):
    flight = fly_px4(companion, parameters={"EKF2_EV_CTRL": 0})
    start_s = gnss_off(flight)
    flight.fly(10.0)
    assert flight.pilot.source == "none"
    assert flight.pilot.failsafe_t_s - start_s == pytest.approx(4.0, abs=0.3)


def test_a_quality_minimum_rejects_every_position(companion):
    flight = fly_px4(companion, parameters={"EKF2_EV_QMIN": 50})
    gnss_off(flight)
    assert flight.fly(10.0).pilot.failsafe is not None


def test_nan_height_discards_the_whole_position(companion):
    flight = fly_px4(companion, settle_s=1.0)
    flight.true_local = lambda: (*type(flight).true_local(flight)[:2], NAN)
    flight.fly(2.0)
    gnss_off(flight)
    assert flight.fly(10.0).pilot.failsafe is not None


def test_a_receiver_that_loses_its_fix_lands_the_copter_after_five_seconds(companion):
    flight = fly_px4(companion, faults=faults.jam(10.0), sending=False).fly(12.0)
    assert flight.pilot.failsafe_t_s - 10.0 == pytest.approx(5.1, abs=0.4)
    assert flight.texts
    assert flight.pilot.mode == "land"


def test_a_lost_fix_hands_over_to_vision_by_itself_after_seven_seconds(companion):
    flight, seen = fly_px4(companion, faults=faults.jam(10.0)), {}
    flight.fly(25.0, lambda: seen.setdefault(flight.pilot.source, flight.pilot.t_s - 10.0))
    assert 6.7 <= seen["external"] <= 7.6
    assert flight.pilot.failsafe is None
    assert flight.rms_m(20.0) < 1.0


@pytest.mark.parametrize(("outage_s", "fails"), [(1.5, False), (3.0, False), (6.0, True), (10.0, True)])
def test_an_outage_ends_in_a_blind_landing_4_6_s_after_the_last_sample(companion, outage_s, fails):
    flight = fly_px4(companion)
    gnss_off(flight)
    flight.fly(10.0)
    flight.sending, start_s = False, flight.pilot.t_s
    flight.fly(outage_s)
    assert (flight.pilot.failsafe is not None) is fails
    if fails:
        assert flight.pilot.failsafe_t_s - start_s == pytest.approx(4.6, abs=0.3)
    else:
        assert flight.error_m[-1][1] < 3.0


def test_a_spoofed_gnss_wins_over_vision_until_it_is_switched_off(companion):
    flight = fly_px4(companion, faults=faults.slow_drag(10.0, 1.0, 0.0)).fly(32.0)
    assert flight.pilot.source == "gnss"
    assert flight.error_m[-1][1] == pytest.approx(30.0, abs=2.0)
    assert flight.pilot.pulled_m == pytest.approx(30.0, abs=1.0)
    gnss_off(flight)
    flight.fly(2.0)
    assert flight.error_m[-1][1] < 2.0
    assert flight.pilot.source == "external"
    flight.set_px4_integer("EKF2_GPS_CTRL", 7)
    flight.fly(2.0)
    assert flight.pilot.source == "gnss"


@pytest.mark.parametrize(("bump", "at_least_s", "at_most_s"), [(1, 0.0, 0.6), (0, 1.0, 1.6)])
def test_a_jump_is_followed_at_once_with_and_after_a_second_without_a_reset_counter(companion, bump, at_least_s, at_most_s):
    flight = fly_px4(companion)
    gnss_off(flight)
    flight.fly(10.0)
    start_s, flight.offset_m = flight.pilot.t_s, (20.0, 0.0)
    flight.reset_counter += bump
    flight.fly(5.0)
    assert at_least_s <= flight.first_s(start_s, 16.0) <= at_most_s


def test_time_stamps_are_used_once_timesync_converged(companion):
    """Latency 150 ms at 6 m/s: 0.9 m along the track while arrival times are used, removed after 500 replies (50 s)."""
    flight = fly_px4(companion, settle_s=5.0, sigma_m=0.05, latency_s=0.15, mission=[(0, 0, -40), (2000, 0, -40)], step_s=0.01)
    gnss_off(flight)
    flight.fly(30.0)
    assert flight.heard["TIMESYNC"] > 300
    assert flight.rms_m(20.0) > 0.6
    flight.fly(30.0)
    assert flight.rms_m(58.0) < 0.3


def test_without_answers_arrival_times_stay_in_use(companion):
    flight = companion(
        kind="px4", speed_mps=6.0, sigma_m=0.05, latency_s=0.15, mission=[(0, 0, -40), (2000, 0, -40)], step_s=0.01
    )  # fmt: skip
    flight.answers_timesync = False
    flight.fly(5.0)
    gnss_off(flight)
    flight.fly(60.0)
    assert flight.rms_m(58.0) > 0.6


@pytest.mark.parametrize(("latency_s", "delay_max", "fused"), [(0.28, 200, False), (0.35, 200, False), (0.35, 500, True)])
def test_positions_older_than_delay_max_are_dropped(companion, latency_s, delay_max, fused):
    flight = fly_px4(companion, settle_s=53.0, latency_s=latency_s, parameters={"EKF2_DELAY_MAX": delay_max}, step_s=0.01)
    gnss_off(flight)
    flight.fly(12.0)
    assert (flight.pilot.source == "external") is fused
    assert (flight.pilot.failsafe is None) is fused


def test_estimator_status_tells_gnss_in_use_from_aiding(companion):
    flight = fly_px4(companion)
    flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS, 1e5)
    flight.fly(1.0)
    assert flight.last["ESTIMATOR_STATUS"].flags & 0x300 == 0x300
    gnss_off(flight)
    flight.fly(2.0)
    assert flight.last["ESTIMATOR_STATUS"].flags & 0x300 == 0x100
    flight.sending = False
    flight.fly(8.0)
    assert flight.last["ESTIMATOR_STATUS"].flags & 0x310 == 0


def test_the_blind_landing_descends_and_drifts_with_the_wind(companion):
    flight = fly_px4(companion, sending=False, mission=[(0, 0, -30)])
    gnss_off(flight)
    flight.fly(10.0)
    before = flight.pilot.truth().p_ned_m
    flight.fly(60.0)
    after = flight.pilot.truth().p_ned_m
    assert flight.pilot.mode == "landed"
    assert after[2] == 0.0
    assert after[0] - before[0] > 40.0  # 3 m/s north, 2.6 m/s east
    assert flight.pilot.truth().landed


def test_unknown_covariance_counts_as_ten_centimetres_and_is_worse_than_an_honest_one(companion):
    rms_m = []
    for variance_m2 in (None, (NAN, NAN, NAN)):
        flight = fly_px4(companion, variance_m2=variance_m2)
        gnss_off(flight)
        rms_m.append(flight.fly(60.0).rms_m(20.0))
    assert rms_m[1] > 1.5 * rms_m[0]


def test_a_gate_of_zero_does_not_stop_the_flight(companion):
    flight = fly_px4(companion, parameters={"EKF2_EVP_GATE": 0.0})
    gnss_off(flight)
    assert flight.fly(10.0).pilot.t_s > 17.0


def test_a_plane_stays_valid_on_airspeed(companion):
    flight = fly_px4(companion, vehicle="plane", mission=[(0, 0, -100)], speed_mps=22.0, sending=False)
    gnss_off(flight)
    flight.fly(30.0)
    assert flight.pilot.failsafe is None
    assert flight.pilot.position_ok
    assert flight.rms_m(10.0) < 30.0


def test_a_reset_counter_beside_gnss_only_moves_the_bias(companion):
    flight = fly_px4(companion)
    flight.offset_m = (50.0, 0.0)
    flight.reset_counter += 1
    flight.fly(5.0)
    assert flight.max_m(6.0) < 1.5
    gnss_off(flight)
    flight.fly(2.0)
    assert flight.error_m[-1][1] == pytest.approx(50.0, abs=2.0)  # raw external positions now


def local_error_mps(flight):
    local, true = flight.last["LOCAL_POSITION_NED"], flight.pilot.truth()
    return math.hypot(local.vx - true.v_ned_mps[0], local.vy - true.v_ned_mps[1])


def test_without_gnss_from_boot_a_velocity_that_nobody_vouches_for_goes_on_and_drifts(companion):
    flight = companion(kind="px4", sending=False, faults=faults.no_gnss(), model=PX4_SIH)
    for number in (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS):
        flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 100_000)
    early_mps = local_error_mps(flight.fly(2.0))
    assert local_error_mps(flight.fly(58.0)) > early_mps + 2.0
    vouched = mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert not flight.last["ESTIMATOR_STATUS"].flags & vouched


def test_on_the_ground_it_stands_still_without_gnss(companion):
    flight = companion(kind="px4", sending=False, faults=faults.no_gnss(), model=PX4_SIH, start_airborne=False)
    for number in (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS):
        flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 100_000)
    assert local_error_mps(flight.fly(60.0)) < 0.5
    assert flight.last["ESTIMATOR_STATUS"].flags & mavlink.ESTIMATOR_CONST_POS_MODE
