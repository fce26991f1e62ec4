"""The gate in front of the outbox."""

import math
from dataclasses import replace

import pytest

from visloc_companion.adapters.mavlink.outputs.fence import CATCH_UP_MPS, MAX_AGE_NS, MAX_LEAD_NS, Fence, Gate
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.errors import Reason
from visloc_companion.geo.wgs84 import autopilot_ned_from_geo, geo_from_ned
from visloc_companion.types import AutopilotKind, GeoPoint

KIND = AutopilotKind.ARDUPILOT
ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)
FENCE = Fence(47.39, 8.54, 47.41, 8.56, 300.0)
VPE, GPS, ESTIMATE = Output.VISION_POSITION_ESTIMATE, Output.GPS_INPUT, Output.EXTERNAL_POSITION_ESTIMATE
S = 1_000_000_000


def judge(gate, what, output=VPE, now_ns=None, origin=ORIGIN):
    return gate.judge(what, output, KIND, origin, what.t_ns if now_ns is None else now_ns)


def at(injection, t_s, north_m=0.0, counter=0, **changes):
    changes = {"v_ned_mps": (10.0, 0.0, 0.0), **changes}
    return injection(t_ns=round(t_s * S), p_ned_m=(north_m, 0.0, -42.0), reset_counter=counter, **changes)


def test_a_sound_position_of_now_passes_as_it_is(injection):
    what = injection()
    assert judge(Gate(FENCE, 5.0), what) == what


def test_stale_future_and_backward_times_are_refused(injection):
    what, gate = injection(), Gate(None, 5.0)
    assert judge(gate, what, now_ns=what.t_ns + MAX_AGE_NS + 1) is Reason.TOO_OLD
    assert judge(gate, what, now_ns=what.t_ns - MAX_LEAD_NS - 1) is Reason.IMPLAUSIBLE_TIME
    assert judge(gate, what, now_ns=what.t_ns + MAX_AGE_NS) == what
    assert judge(gate, replace(what, t_ns=what.t_ns - 1), now_ns=what.t_ns) is Reason.IMPLAUSIBLE_TIME


def test_without_or_about_another_origin_nothing_passes(injection):
    assert judge(Gate(None, 5.0), injection(), origin=None) is Reason.NO_ORIGIN
    moved = geo_from_ned((2.0, 0.0, 0.0), ORIGIN)
    assert judge(Gate(None, 5.0), injection(), origin=moved) is Reason.BAD_INPUT


@pytest.mark.parametrize(
    ("north_m", "east_m", "inside"),
    [(0, 0, True), (-1150, 0, True), (-1180, 0, False), (0, 1370, True), (0, 1500, False), (1660, 0, True), (1750, 0, False)],
)
def test_the_fence_is_the_map_and_its_margin(injection, north_m, east_m, inside):
    what = injection(p_ned_m=(float(north_m), float(east_m), -42.0))
    got = judge(Gate(FENCE, 5.0), what)
    assert got == what if inside else got is Reason.OUTSIDE_MAP


def test_a_fence_across_the_date_line():
    fence = Fence(-1.0, 179.9, 1.0, -179.9, 0.0)
    assert fence.contains(GeoPoint(0.0, 179.95, 0.0))
    assert fence.contains(GeoPoint(0.0, -179.95, 0.0))
    assert not fence.contains(GeoPoint(0.0, -179.8, 0.0))
    assert not fence.contains(GeoPoint(0.0, 0.0, 0.0))


def test_a_step_that_nobody_announced_is_announced_and_one_that_was_is_not_counted_twice(injection):
    gate = Gate(None, 5.0)
    sent = [
        judge(gate, what).reset_counter
        for what in (
            at(injection, 1.0),
            at(injection, 1.1, 1.0),
            at(injection, 1.2, 6.9),
            at(injection, 1.3, 30.0),
            at(injection, 1.4, 31.0),
            at(injection, 1.5, 90.0, counter=1),
            at(injection, 1.6, 91.0, counter=1),
        )
    ]
    assert sent == [0, 0, 0, 1, 1, 2, 2]


def test_a_counter_of_255_goes_on_at_zero(injection):
    gate = Gate(None, 5.0)
    judge(gate, at(injection, 1.0, counter=255))
    assert judge(gate, at(injection, 1.1, 100.0, counter=255)).reset_counter == 0


def test_a_message_without_a_counter_claims_a_step_as_uncertainty_for_a_while(injection):
    gate = Gate(None, 5.0)
    known = ((1.0, 0.0), (0.0, 1.0))
    judge(gate, at(injection, 1.0, cov_ne_m2=known), GPS)
    stepped = judge(gate, at(injection, 1.1, 21.0, cov_ne_m2=known), GPS)
    assert math.sqrt(stepped.cov_ne_m2[0][0]) == pytest.approx(math.hypot(1.0, 20.0))
    later = judge(gate, at(injection, 3.1, 41.0, cov_ne_m2=known), GPS)
    assert math.sqrt(later.cov_ne_m2[1][1]) == pytest.approx(math.hypot(1.0, 20.0 - 2.0 * CATCH_UP_MPS))
    assert judge(gate, at(injection, 13.1, 141.0, cov_ne_m2=known), GPS).cov_ne_m2 == known


def test_an_estimate_for_dead_reckoning_is_a_reset_itself(injection):
    gate = Gate(None, 5.0)
    judge(gate, at(injection, 1.0), ESTIMATE)
    assert judge(gate, at(injection, 3.0, 200.0), ESTIMATE).cov_ne_m2 == at(injection, 3.0).cov_ne_m2


def test_what_needs_a_velocity_waits_for_one_and_is_not_taken_for_sent(injection):
    gate = Gate(None, 5.0)
    judge(gate, at(injection, 1.0), GPS)
    assert judge(gate, at(injection, 1.1, 50.0, v_ned_mps=None), GPS) is Reason.NOT_SEEDED
    assert judge(gate, at(injection, 1.2, 51.0), GPS).reset_counter == 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"cov_ne_m2": ((math.nan, 0.0), (0.0, 1.0))}, Reason.NOT_FINITE),
        ({"q_ned_frd": (math.inf, 0.0, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"place": GeoPoint(math.nan, 8.0, 500.0)}, Reason.NOT_FINITE),
        ({"v_ned_mps": (math.nan, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"cov_v_ne_m2ps2": ((math.nan, 0.0), (0.0, 1.0))}, Reason.NOT_FINITE),
        ({"q_ned_frd": (0.0, 0.0, 0.0, 0.0)}, Reason.BAD_INPUT),
        ({"cov_ne_m2": ((1.0, 2.0), (2.0, 1.0))}, Reason.BAD_INPUT),
        ({"cov_ne_m2": ((-1.0, 0.0), (0.0, 1.0))}, Reason.BAD_INPUT),
        ({"cov_ne_m2": ((1e7, 0.0), (0.0, 1.0))}, Reason.BAD_INPUT),
        ({"sigma_d_m": 0.0}, Reason.BAD_INPUT),
        ({"sigma_yaw_rad": -0.1}, Reason.BAD_INPUT),
        ({"stream_sigma_m": math.nan}, Reason.NOT_FINITE),
        ({"stream_sigma_m": -1.0}, Reason.BAD_INPUT),
        ({"v_ned_mps": (0.0, 500.0, 0.0)}, Reason.BAD_INPUT),
        ({"place": GeoPoint(91.0, 8.0, 500.0)}, Reason.BAD_INPUT),
        ({"place": GeoPoint(47.3, 8.0, 60_000.0)}, Reason.BAD_INPUT),
        ({"t_ns": -1}, Reason.BAD_INPUT),
    ],
)
def test_what_is_not_sound_is_refused(injection, change, reason):
    assert judge(Gate(None, 5.0), injection(**change)) is reason


@pytest.mark.parametrize("output", [GPS, Output.GLOBAL_POSITION_SENSOR])
def test_another_origin_is_no_step_where_latitude_and_longitude_are_sent(injection, output):
    gate, moved = Gate(None, 5.0), geo_from_ned((5000.0, 0.0, 0.0), ORIGIN)
    first = at(injection, 1.0, v_ned_mps=(0.0, 0.0, 0.0))
    assert judge(gate, first, output) == first
    local_m = autopilot_ned_from_geo(KIND, first.place, moved)
    second = replace(first, t_ns=first.t_ns + S // 10, p_ned_m=local_m, reset_counter=1)
    assert judge(gate, second, output, origin=moved) == second
