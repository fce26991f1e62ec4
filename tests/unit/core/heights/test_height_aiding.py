"""From the navigator's events to the filter of the height: which height a fix is held against, and what its prior knew."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from visloc_companion.core.heights.height_aiding import HeightAiding
from visloc_companion.core.remembered import REQUESTS_KEPT
from visloc_companion.core.requests import UNKNOWN_HEIGHT_SIGMA_M
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Fix, FrameRef, GeoPoint, LocaliseRequest, PosePrior

S = 1_000_000_000
COV = ((1.0, 0.0), (0.0, 1.0))
LEVEL = (1.0, 0.0, 0.0, 0.0)
V_NE = (8.0, 6.0)


def fix(t_s: float, h_amsl_m: float, sigma_m: float = 1.0, request_id: int = 1) -> Fix:
    place, t_ns = GeoPoint(47.0, 8.0, h_amsl_m), round(t_s * S)
    return Fix(t_ns, t_ns, request_id, request_id, "deep", place, LEVEL, COV, sigma_m, 0.02, 1e-3, 100.0)


def level_m(on_m: float, turned_deg: float, above_ground_m: float = 100.0, footprint_m: float = 100.0) -> float:
    """After two seconds at each of ten places so far apart, the camera turned up by so much more at each."""
    aiding = HeightAiding(NavigatorSettings())
    for k in range(1, 41):
        aiding.drive(k * S // 2, 100.0, 50.0)
        place = GeoPoint(47.0 + on_m * (k // 4) / 111e3, 8.0, 100.0)
        q = quat_from_euler(0.0, math.radians(turned_deg * (k // 4)), 0.0)
        seen = replace(fix(k / 2, 100.0, 0.5, request_id=k), place=place, q_ned_frd=q)
        aiding.taken(replace(seen, above_ground_m=above_ground_m, footprint_m=footprint_m), (0.0, 0.0))
    height = aiding.at(20 * S, 100.0)
    assert height is not None
    return height.protection_level_m


def test_who_stays_over_one_ground_has_its_wrong_match_in_the_level() -> None:
    hovering_m = level_m(0.0, 0.0)
    assert hovering_m > 1.2 * level_m(30.0, 0.0)
    assert hovering_m > 1.2 * level_m(0.0, 6.0), "the camera was turned to other ground"
    assert level_m(30.0, 0.0, footprint_m=3000.0) == pytest.approx(hovering_m, rel=0.05)


def request(request_id: int, h_amsl_m: float, sigma_m: float) -> LocaliseRequest:
    prior = PosePrior(GeoPoint(47.0, 8.0, h_amsl_m), LEVEL, COV, sigma_m, 0.1, 0.02)
    return LocaliseRequest(request_id, FrameRef(0, 0, request_id, 0, 640, 480, 3), prior, 1)


def climbing() -> HeightAiding:
    """100 m at 0 s, 2 m/s up, reports twice a second until 10 s."""
    aiding = HeightAiding(NavigatorSettings())
    for k in range(21):
        aiding.drive(k * S // 2, 100.0 + k, 50.0 + k)
    return aiding


def test_nothing_is_known_before_the_autopilot_states_a_height() -> None:
    aiding = HeightAiding(NavigatorSettings())
    aiding.taken(fix(1.0, 100.0), V_NE)
    assert aiding.at(S, 100.0) is None


def test_a_fix_is_held_against_the_height_at_its_own_time() -> None:
    aiding = climbing()
    for k in range(60, 100):
        aiding.taken(fix(k / 10, 100.0 + 2 * k / 10 + 3.0, request_id=k), V_NE)
    height = aiding.at(10 * S, 120.0)
    assert height is not None
    assert height.offset_m == pytest.approx(3.0, abs=0.3)
    assert height.protection_level_m > 3.0


def test_terrain_has_no_prior_in_its_height() -> None:
    """The prior only says where it looks: a fix that knows no more than its prior tells as much as it claims, and one that
    knows more is not held to lie beyond itself."""
    for prior_sigma_m in (1.4, 2.0):
        aiding = climbing()
        aiding.asked(request(1, 110.0, prior_sigma_m))
        told = replace(fix(5.0, 113.0, 1.4), method="terrain", footprint_m=None)
        assert aiding.own_m(told) == pytest.approx((3.0, 1.4))
        aiding.taken(told, V_NE)
        offset_m, sigma_m, _ = aiding.known(5 * S, 110.0)
        assert offset_m == pytest.approx(2.6, abs=0.1), "between 0 at 3.5 m and 3 at 1.4 m"
        assert sigma_m == pytest.approx(1.3, abs=0.2)


def test_priors_rest_on_what_fixes_found() -> None:
    """Offset and 1-sigma of the sum, which grows again where no fix comes."""
    aiding = climbing()
    assert HeightAiding(NavigatorSettings()).known(S, 100.0).sigma_m == UNKNOWN_HEIGHT_SIGMA_M
    before = aiding.known(10 * S, 120.0)
    for k in range(60, 100):
        aiding.taken(fix(k / 10, 100.0 + 2 * k / 10 + 3.0, 0.3, request_id=k), V_NE)
    after, later = aiding.known(10 * S, 120.0), aiding.known(100 * S, 120.0)
    assert before.offset_m == 0.0
    assert after.offset_m == pytest.approx(3.0, abs=0.1)
    assert after.sigma_m < 0.4 < later.sigma_m < before.sigma_m


def test_what_the_prior_knew_is_not_counted_again() -> None:
    """Fixes that repeat their prior's height (off by 5 m) to within its sigma teach nothing."""
    aiding = climbing()
    for k in range(60, 100):
        aiding.asked(request(k, 125.0, 1.5))
        aiding.taken(fix(k / 10, 125.0, 1.5, request_id=k), V_NE)
    height = aiding.at(10 * S, 120.0)
    assert height is not None
    assert height.offset_m == 0.0


def test_priors_of_old_requests_are_forgotten() -> None:
    aiding = climbing()
    for k in range(3 * REQUESTS_KEPT):
        aiding.asked(request(k, 120.0, 1.5))
    assert len(aiding._priors) == REQUESTS_KEPT


@pytest.mark.parametrize("t_s", [-5.0, 14.0])
def test_a_fix_far_from_any_report_is_left_out(t_s: float) -> None:
    aiding = climbing()
    aiding.taken(fix(t_s, 200.0), V_NE)
    height = aiding.at(10 * S, 120.0)
    assert height is not None
    assert height.offset_m == 0.0


def test_an_answer_stands_until_a_fix_a_climb_or_half_a_second() -> None:
    aiding = climbing()
    first = aiding.at(10 * S, 120.0)
    assert aiding.at(10 * S + S // 10, 120.0) is first
    assert aiding.at(10 * S + S // 2, 120.0) is not first
    assert aiding.at(10 * S + 2 * S // 3, 122.0) is not aiding.at(10 * S + 2 * S // 3, 120.0)
    before = aiding.at(11 * S, 120.0)
    aiding.taken(fix(9.5, 130.0), V_NE)
    assert aiding.at(11 * S, 120.0) is not before


def test_after_a_restart_of_the_autopilot_heights_begin_anew() -> None:
    aiding = climbing()
    aiding.forget_heights()
    aiding.taken(fix(9.0, 150.0), V_NE)
    height = aiding.at(10 * S, 120.0)
    assert height is not None
    assert height.offset_m == 0.0
    aiding.drive(11 * S, 122.0, 72.0)
    aiding.drive(10 * S, 500.0, 72.0)  # late: left out
    aiding.taken(fix(11.2, 125.0), V_NE)
    later = aiding.at(12 * S, 122.0)
    assert later is not None
    assert 1.0 < later.offset_m <= 3.0


def taught(steps_m: list[float]) -> HeightAiding:
    """A level flight of 20 s at 100 m that fixes found 3 m too low, then heights off by these, ten a second, at no velocity."""
    aiding = HeightAiding(NavigatorSettings())
    for k in range(200):
        aiding.drive(k * S // 10, 100.0, 50.0, 0.0)
        if k % 5 == 0:
            aiding.taken(fix(k / 10, 103.0, 0.4, request_id=k), V_NE)
    for k, step_m in enumerate(steps_m):
        aiding.drive(20 * S + k * S // 10, 100.0 + step_m, 50.0, 0.0)
    return aiding


@pytest.mark.parametrize(
    ("steps_m", "sigma_m"),
    [([8.0] * 10, 8.0), ([0.8 * k for k in range(1, 11)], 8.0), ([1.0, 0.0] * 5, 1.0), ([0.02 * k for k in range(10)], 0.0)],
)
def test_a_height_that_jumps_is_doubted_by_its_jump(steps_m: list[float], sigma_m: float) -> None:
    """At once, within a second, there and back (as of two messages that disagree), and a drift that is none."""
    at_ns = 20 * S + (len(steps_m) - 1) * S // 10
    known, before = taught(steps_m).known(at_ns, 100.0), taught([]).known(at_ns, 100.0)
    assert known.sigma_m**2 - before.sigma_m**2 == pytest.approx(sigma_m**2, rel=0.05, abs=0.01)


@pytest.mark.parametrize(("zero_m", "sigma_m"), [(453.8, 3.0), (-453.8, 3.0), (8.0, math.hypot(3.0, 8.0))])
def test_before_any_fix_a_height_over_another_zero_is_as_good_as_a_first_one(zero_m: float, sigma_m: float) -> None:
    """PX4 has an origin at sea level for its first second."""
    aiding = HeightAiding(NavigatorSettings())
    aiding.drive(S, 0.8, 0.0, 0.0)
    aiding.drive(S + S // 10, 0.8 + zero_m, 0.0, 0.0)
    known = aiding.known(2 * S, 0.8 + zero_m)
    assert (known.offset_m, known.sigma_m) == (0.0, pytest.approx(sigma_m, rel=0.02))


def test_after_a_jump_the_next_fix_tells_the_height() -> None:
    aiding = taught([8.0] * 10)
    aiding.taken(fix(21.0, 103.0, 0.4, request_id=500), V_NE)
    known = aiding.known(21 * S, 108.0)
    assert known.offset_m == pytest.approx(-5.0, abs=0.3)
    assert known.sigma_m < 0.7


def test_a_climb_that_is_told_is_no_jump() -> None:
    aiding = HeightAiding(NavigatorSettings())
    for k in range(100):
        aiding.drive(k * S // 10, 100.0 + 0.5 * k, 50.0, -5.0)
    still = HeightAiding(NavigatorSettings())
    for k in range(100):
        still.drive(k * S // 10, 100.0 + 0.5 * k, 50.0)
    assert aiding.known(10 * S, 150.0) == still.known(10 * S, 150.0)


@pytest.mark.parametrize("zero_m", [-30.0, 0.0, 30.0])
def test_an_autopilot_that_was_restarted_may_count_its_height_from_another_zero(zero_m: float) -> None:
    """Its height was known to be 3 m too low to half a metre; the next one, 5 s later at the same place, is off by another."""
    aiding = taught([])
    aiding.forget_heights()
    for k in range(20):
        aiding.drive(25 * S + k * S // 10, 100.0 + zero_m, 50.0, 0.0)
    height, known = aiding.at(27 * S, 100.0 + zero_m), aiding.known(27 * S, 100.0 + zero_m)
    assert height is not None
    assert height.protection_level_m > abs(3.0 - zero_m)
    assert abs(3.0 - zero_m - known.offset_m) < 2 * known.sigma_m, "a prior as wide finds the place again"
    aiding.taken(fix(27.0, 103.0, 0.4, request_id=500), V_NE)
    assert aiding.known(27 * S, 100.0 + zero_m).offset_m == pytest.approx(3.0 - zero_m, abs=0.5)


@pytest.mark.parametrize("zero_m", [-90.0, -40.0, 250.0])
def test_beyond_the_widest_prior_it_is_looked_for_at_the_height_that_it_had(zero_m: float) -> None:
    aiding = taught([])
    aiding.forget_heights()
    aiding.drive(25 * S, 100.0 + zero_m, 0.0, 0.0)
    height, known = aiding.at(25 * S, 100.0 + zero_m), aiding.known(25 * S, 100.0 + zero_m)
    assert height is not None
    assert known.offset_m == pytest.approx(3.0 - zero_m, abs=0.5)
    assert known.sigma_m >= 20.0
    assert height.protection_level_m > abs(zero_m) + 20.0, "it may have climbed by as much, too"


def test_a_step_of_our_own_clock_leaves_what_is_known_of_the_height() -> None:
    aiding, still = taught([]), taught([])
    aiding.forget_heights(restarted=False)
    for each in (aiding, still):
        each.drive(25 * S, 100.0, 50.0, 0.0)
    assert aiding.known(26 * S, 100.0) == still.known(26 * S, 100.0)


def test_steps_of_a_height_are_told_from_its_climbs() -> None:
    """Between the two reports about a step it is as far as the height is, and it is remembered when these are forgotten."""
    aiding = HeightAiding(NavigatorSettings())
    for k in range(400):
        t_s = k / 10
        aiding.drive(k * S // 10, 500.0 + 2.0 * t_s + 8.0 * (t_s >= 5) - 3.0 * (t_s >= 9), 100.0 + 2.0 * t_s, v_down_mps=-2.0)
    assert aiding.stepped_m(39 * S) == pytest.approx(5.0)
    early = HeightAiding(NavigatorSettings())
    for k in range(100):
        early.drive(k * S // 10, 500.0 + 8.0 * (k >= 50), 100.0, v_down_mps=0.0)
    assert [early.stepped_m(t_ns) for t_ns in (4 * S, 4_950_000_000, 5 * S, 9 * S)] == pytest.approx([0.0, 4.0, 8.0, 8.0])


def test_what_a_height_does_while_none_is_heard_is_no_step() -> None:
    aiding = HeightAiding(NavigatorSettings())
    for t_s, h_amsl_m in ((0, 500.0), (1, 500.0), (6, 512.0), (7, 512.0)):
        aiding.drive(t_s * S, h_amsl_m, 100.0, v_down_mps=0.0)
    assert aiding.stepped_m(7 * S) == 0.0


def test_before_a_height_is_stated_none_is_held_or_let_loose() -> None:
    aiding = HeightAiding(NavigatorSettings())
    aiding.loosen(S, 5.0)
    aiding.hold(S, 3.0, 0.5)
    assert aiding.at(S, 100.0) is None
    aiding.drive(S, 100.0, 50.0)
    plain = HeightAiding(NavigatorSettings())
    plain.drive(S, 100.0, 50.0)
    assert aiding.known(S, 100.0) == plain.known(S, 100.0)
    aiding.hold(S, 3.0, 0.5)
    assert aiding.known(S, 100.0).offset_m == 3.0


def test_a_step_of_long_ago_counts_for_good_when_another_comes() -> None:
    aiding = HeightAiding(NavigatorSettings())
    for k in range(450):
        h_amsl_m = 500.0 + 8.0 * (k >= 50) - 3.0 * (k >= 200) + 8.0 * (k >= 400)
        aiding.drive(k * S // 10, h_amsl_m, 100.0, v_down_mps=0.0)
    assert [aiding.stepped_m(t_s * S) for t_s in (30, 39, 44)] == pytest.approx([5.0, 5.0, 13.0])
    assert len(aiding._steps) == 1
