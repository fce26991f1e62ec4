"""The outputs that name a place on the globe."""

import math

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.outputs.external_estimate import WRAP_S, external_position_estimate
from visloc_companion.adapters.mavlink.outputs.global_position import global_position_sensor
from visloc_companion.adapters.mavlink.outputs.gps_input import gps_input, gps_time
from visloc_companion.errors import Reason

SIGMA_M = math.sqrt((4 + 1) / 2 + math.hypot(1.5, 0.5))
"""The larger semi-axis of the injection's covariance."""
S = 1_000_000_000


def place_of(message):
    return message.lat * 1e-7, message.lon * 1e-7


def test_px4_reads_id_place_and_sigmas_of_a_position_sensor(injection, wire):
    what = injection()
    got = wire(global_position_sensor(what, 4, 7))
    assert (got.get_msgId(), got.id, got.target_system, got.target_component) == (296, 7, 4, 1)
    assert place_of(got) == pytest.approx((what.place.lat_deg, what.place.lon_deg), abs=1e-7)
    assert (got.alt, got.eph, got.epv) == pytest.approx((what.place.h_amsl_m, SIGMA_M, 3.0), rel=1e-6)
    assert (got.source, got.time_usec, got.processing_time) == (mav.GLOBAL_POSITION_SRC_VISION, 7_000_123, 0)
    assert math.isnan(got.alt_ellipsoid)


def test_a_receiver_claims_what_we_know_and_leaves_out_the_rest(injection, wire):
    what = injection()
    got = wire(gps_input(what, 1, 1_780_000_000 * S))
    assert (got.gps_id, got.fix_type, got.yaw) == (1, 3, 0)
    assert place_of(got) == pytest.approx((what.place.lat_deg, what.place.lon_deg), abs=1e-7)
    assert got.alt == pytest.approx(what.place.h_amsl_m)
    assert (got.vn, got.ve) == pytest.approx((9.0, -4.0))
    assert got.horiz_accuracy == pytest.approx(SIGMA_M)
    assert got.hdop == pytest.approx(SIGMA_M)
    assert got.vert_accuracy == 3.0
    assert got.speed_accuracy == pytest.approx(math.sqrt(0.26 + math.hypot(0.1, 0.05)))
    assert got.satellites_visible >= 6  # ArduPilot aligns with no fewer


def test_a_receivers_vertical_velocity_and_vdop_are_ignored_and_nothing_else(injection, wire):
    flags = wire(gps_input(injection(), 0, None)).ignore_flags
    assert flags == mav.GPS_INPUT_IGNORE_FLAG_VDOP | mav.GPS_INPUT_IGNORE_FLAG_VEL_VERT
    assert not flags & mav.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ


@pytest.mark.parametrize("change", [{"v_ned_mps": None}, {"cov_v_ne_m2ps2": None}])
def test_there_is_no_receiver_without_a_velocity(injection, change):
    assert gps_input(injection(**change), 1, None) is Reason.NOT_SEEDED


def test_gps_time_counts_weeks_since_1980_with_leap_seconds():
    assert gps_time(1_700_000_000 * S) == (2288, 252_818_000)  # 14 November 2023, 22:13:20 UTC: a Tuesday
    assert gps_time(None) == (0, 0)
    assert gps_time(0) == (0, 0)


def test_the_hdop_of_a_lost_position_fits_its_field(injection, wire):
    assert wire(gps_input(injection(cov_ne_m2=((1e6, 0.0), (0.0, 1e6))), 1, None)).hdop == pytest.approx(99.99)


def test_a_position_estimate_for_dead_reckoning_is_global_without_altitude(injection, wire):
    what = injection()
    got = wire(external_position_estimate(what, 4))
    assert (got.get_type(), got.command, got.frame) == ("COMMAND_INT", 43003, mav.MAV_FRAME_GLOBAL)
    assert math.isnan(got.z)
    assert (got.x * 1e-7, got.y * 1e-7) == pytest.approx((what.place.lat_deg, what.place.lon_deg), abs=1e-7)
    assert got.param1 == pytest.approx(7.000123, abs=1e-6)
    assert (got.param2, got.param3) == pytest.approx((0.0, SIGMA_M))
    assert (got.target_system, got.target_component) == (4, 1)


def test_its_time_stays_good_to_8_ms_however_long_the_computer_runs(injection, wire):
    for days in (0.0, 0.5, 3.3, 400.0):
        t_ns = round(days * 86_400 * S) + 123_456_789
        got = wire(external_position_estimate(injection(t_ns=t_ns), 1)).param1
        assert abs(got - t_ns * 1e-9 % WRAP_S) < 0.008
