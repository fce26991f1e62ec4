"""Figures that docs/ardupilot.md states of the maker's simulator: the simulated ArduPilot must land near them."""

import math
import statistics

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from visloc_companion.sim import faults
from visloc_companion.sim.estimators.estimator_ardupilot import position_error_m

SET_SOURCE = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
NAN = math.nan


def on_vision(companion, **more):
    """A flight whose GNSS fails at 12 s and that was switched to external positions at 10 s; now at 20 s."""
    options = {"parameters": {"VISO_DELAY_MS": 100}, "faults": faults.jam(12.0), "rate_hz": 4.0} | more
    flight = companion(**options).fly(10.0)
    assert flight.command(SET_SOURCE, 2) == mavlink.MAV_RESULT_ACCEPTED
    return flight.fly(10.0)


@pytest.mark.parametrize(("rate_hz", "rms_m"), [(0.5, 1.41), (1.0, 1.17), (4.0, 0.69), (10.0, 0.50)])
def test_accuracy_follows_the_rate_as_measured(companion, rate_hz, rms_m):
    flight = on_vision(companion, rate_hz=rate_hz).fly(150.0)
    assert flight.rms_m(25.0) == pytest.approx(rms_m, rel=0.25)
    assert not flight.texts
    assert flight.pilot.flight.health().flags == 0x33F


def test_uncompensated_latency_becomes_an_error_along_the_track(companion):
    right = on_vision(companion, latency_s=0.2, sigma_m=0.1, parameters={"VISO_DELAY_MS": 200}).fly(60.0)
    wrong = on_vision(companion, latency_s=0.2, sigma_m=0.1, parameters={"VISO_DELAY_MS": 10}).fly(60.0)
    assert right.rms_m(25.0) < 0.6
    assert 1.0 < wrong.rms_m(25.0) < 2.2  # 1.48 measured


def test_jitter_is_removed_but_not_the_constant_part(companion):
    flight = on_vision(companion, sigma_m=0.1)
    for i in range(200):
        flight.latency_s = 0.1 + 0.05 * (i % 3)
        flight.fly(0.2)
    assert flight.rms_m(25.0) < 0.7


def test_vision_on_an_inactive_source_set_does_not_save_the_flight(companion):
    flight = companion(faults=faults.jam(20.0)).fly(40.0)
    ((t_s, text),) = [entry for entry in flight.texts if "Failsafe" in entry[1]]
    assert text == "EKF Failsafe: changed to LAND"
    assert 7.0 <= t_s - 20.0 <= 8.5
    assert flight.pilot.mode == "land"


@pytest.mark.parametrize("outage_s", [2.0, 5.0])
def test_a_short_outage_is_bridged(companion, outage_s):
    flight = on_vision(companion)
    flight.sending = False
    flight.fly(outage_s)
    assert flight.pilot.failsafe is None
    assert flight.error_m[-1][1] < 6.0


def test_an_outage_drops_the_flags_then_lands_then_stops_aiding(companion):
    flight = on_vision(companion)
    flight.sending, start_s, seen = False, flight.pilot.t_s, {}
    flight.fly(20.0, lambda: seen.setdefault(flight.pilot.flight.health().flags, flight.pilot.t_s - start_s))
    assert 6.6 <= seen[0x25] <= 7.3
    assert 14.6 <= seen[0xA7] <= 15.3
    assert 7.4 <= flight.pilot.failsafe_t_s - start_s <= 8.2
    assert flight.pilot.failsafe == "EKF Failsafe: changed to LAND"
    flight.sending = True
    flight.fly(2.0)
    assert flight.pilot.position_ok
    assert flight.pilot.mode == "land"  # the position recovers, the mode does not
    assert flight.error_m[-1][1] < 6.0


def test_outage_errors_grow_as_measured(companion):
    at_s = {5.0: [], 12.0: []}
    for seed in range(5):
        flight = on_vision(companion, seed=seed, rate_hz=10.0)
        flight.sending = False
        for until_s, before_s in ((5.0, 0.0), (12.0, 5.0)):
            flight.fly(until_s - before_s)
            at_s[until_s].append(flight.error_m[-1][1])
    assert 0.7 < statistics.fmean(at_s[5.0]) < 2.8  # 1.4 measured
    assert 2.1 < statistics.fmean(at_s[12.0]) < 8.6  # 4.3 measured


def jump(companion, by_m, bump, wait_s=15.0, **more):
    """Jump the external positions; seconds until four fifths of the jump are followed, and the peak of the error."""
    flight = on_vision(companion, **more).fly(10.0)
    start_s = flight.pilot.t_s
    flight.offset_m = (by_m, 0.0)
    flight.reset_counter += bump
    flight.fly(wait_s)
    return flight.first_s(start_s, 0.8 * by_m), flight.max_m(start_s)


def test_a_jump_with_a_new_reset_counter_is_followed_at_once(companion):
    after_s, peak_m = jump(companion, 20.0, bump=1)
    assert after_s < 0.6
    assert peak_m < 23.0


def test_a_jump_without_one_is_rejected_for_five_seconds_and_overshoots(companion):
    after_s, peak_m = jump(companion, 20.0, bump=0)
    assert 3.5 <= after_s <= 6.5
    assert 21.0 <= peak_m <= 29.0


def test_a_small_jump_passes_the_gate_and_a_huge_one_waits_for_the_time_out(companion):
    assert 0.7 <= jump(companion, 5.0, bump=0)[0] <= 2.2
    assert 7.0 <= jump(companion, 200.0, bump=0)[0] <= 7.8


def test_without_a_glitch_radius_nothing_is_rejected(companion):
    after_s, peak_m = jump(companion, 20.0, bump=0, parameters={"VISO_DELAY_MS": 100, "EK3_GLITCH_RAD": 0})
    assert 1.0 <= after_s <= 2.8
    assert peak_m > 22.0


def test_one_bad_position_is_harmless(companion):
    flight = on_vision(companion)
    flight.offset_m = (100.0, 0.0)
    flight.fly(0.25)
    flight.offset_m = (0.0, 0.0)
    flight.fly(10.0)
    assert flight.max_m(20.0) < 3.0


def test_unknown_covariance_means_twenty_centimetres_and_a_bad_flight_with_good_flags(companion):
    flight = on_vision(companion, variance_m2=(NAN, NAN, NAN)).fly(60.0)
    assert flight.rms_m(25.0) > 1.5
    assert flight.pilot.flight.health().flags == 0x33F


def test_a_single_finite_covariance_is_an_internal_error(companion):
    assert [text for _, text in on_vision(companion, variance_m2=(1.0, NAN, NAN)).texts] == ["Internal Errors 0x400"]


@pytest.mark.parametrize(("sigma_m", "error_m"), [(0.5, 0.57), (1.0, 1.44), (2.0, 3.6), (5.0, 12.3)])
def test_the_position_error_is_the_cube_root_of_squared_variances(sigma_m, error_m):
    assert position_error_m((sigma_m**2,) * 3, 0.2)[0] == pytest.approx(error_m, abs=0.06)


def test_the_position_error_is_held_between_floor_and_hundred():
    assert position_error_m((0.0, 0.0, 0.0), 0.2) == (0.2, False)
    assert position_error_m((1e6, 1e6, 1e6), 0.2) == (100.0, False)


def test_height_from_vision_with_zero_makes_it_climb(companion):
    flight = on_vision(companion, parameters={"VISO_DELAY_MS": 100, "EK3_SRC2_POSZ": 6}, sigma_m=0.5)
    height_m = -flight.pilot.truth().p_ned_m[2]
    flight.true_local = lambda: (*type(flight).true_local(flight)[:2], 0.0)
    flight.fly(20.0)
    assert -flight.pilot.truth().p_ned_m[2] > height_m + 50.0


def test_height_stays_on_the_barometer_otherwise(companion):
    flight = on_vision(companion)
    flight.true_local = lambda: (*type(flight).true_local(flight)[:2], 0.0)
    flight.fly(20.0)
    assert -flight.pilot.truth().p_ned_m[2] == pytest.approx(40.0, abs=2.0)


def test_switching_back_to_gnss_resets_the_position_without_a_failsafe(companion):
    flight = on_vision(companion, faults=faults.jam(12.0, 22.0)).fly(10.0)
    flight.offset_m = (20.0, 0.0)
    flight.reset_counter += 1
    flight.fly(2.0)
    assert flight.error_m[-1][1] > 15.0
    flight.command(SET_SOURCE, 1)
    flight.fly(1.0)
    assert flight.error_m[-1][1] < 2.0
    assert flight.pilot.source == "gnss"
    assert flight.pilot.failsafe is None


def test_a_source_set_that_does_not_exist_is_denied(companion):
    assert companion().command(SET_SOURCE, 4) == mavlink.MAV_RESULT_DENIED


def test_a_wrong_injection_moves_the_vehicle(companion):
    flight = on_vision(companion, mission=[(0, 0, -40)])
    flight.offset_m = (0.0, 30.0)
    flight.reset_counter += 1
    flight.fly(40.0)
    assert flight.pilot.truth().p_ned_m[1] == pytest.approx(-30.0, abs=3.0)
    assert flight.estimated_local()[1] == pytest.approx(0.0, abs=3.0)


def test_a_plane_dead_reckons_on_airspeed_without_a_failsafe(companion):
    flight = companion(vehicle="plane", mission=[(0, 0, -100)], speed_mps=28.0, faults=faults.jam(60.0), sending=False)
    seen = {}
    flight.fly(60.0)
    flight.fly(60.0, lambda: seen.setdefault(flight.pilot.flight.health().flags, flight.pilot.t_s - 60.0))
    assert 9.8 <= seen[0x12F] <= 10.8  # the absolute position is given up at 10.4 s
    assert flight.rms_m(60.0) < 45.0
    assert flight.pilot.failsafe is None
    assert flight.pilot.mode == "mission"


def test_a_plane_on_vision_is_as_accurate_as_measured(companion):
    flight = on_vision(companion, vehicle="plane", speed_mps=28.0, mission=[(0, 0, -100)]).fly(60.0)
    assert 0.4 < flight.rms_m(25.0) < 1.5
