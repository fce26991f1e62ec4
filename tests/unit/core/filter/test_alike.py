"""Fixes that are wrong by the same offset over the same ground: the level holds until the vehicle has gone on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import alike
from visloc_companion.core.filter.alike import SETTLES, Alike, Taken
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.filter.separation import CLAIM_FLOOR
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Accepted, Fix, GeoPoint, Quat

S = 1_000_000_000
ORIGIN = GeoPoint(47.4, 8.5, 400.0)
SETTINGS = NavigatorSettings()
HEIGHT_M, SIGMA_M, CLAIM = 60.0, 1.0, 0.004
START_SIGMA_M, WRONG_BY_M = 15.0, 25.0


def taken(north_m: float, p: float = 0.01, again: float = 1.0, method: str = "deep", sigma_m: float = 3.0, t_s: int = 0) -> Taken:
    P = sigma_m**2 * np.eye(2)
    off_m = np.array([north_m, 0.0])
    return Taken(t_s * S, method, p, again, off_m, P + np.eye(2), P @ np.linalg.inv(P + np.eye(2)) @ off_m, P)


def after(*fixes: Taken) -> Alike:
    found = alike.NONE
    for fix in fixes:
        found = alike.after_fix(found, fix)
    return found


def test_a_fix_founds_what_it_moved_the_filter_by_known_as_the_filter_was() -> None:
    found = after(taken(5.0))
    assert found.off_m[0].tolist() == pytest.approx([4.5, 0.0])
    assert found.cov_m2[0] == pytest.approx(9.0 * np.eye(2))
    assert found.probability.tolist() == [0.01]
    assert after(taken(5.0, p=1e-7)).probability.tolist() == [CLAIM_FLOOR]


def test_over_the_same_ground_it_stays_as_probable_and_follows_the_filter_until_that_has_settled() -> None:
    found = after(taken(5.0), *[taken(1.0)] * 20)
    assert len(found) == 1
    assert found.probability.tolist() == [0.01]
    assert found.off_m[0, 0] == pytest.approx(4.5 + (SETTLES - 1) * 0.9)


def test_a_later_fix_that_claims_more_founds_its_own() -> None:
    assert after(taken(5.0), taken(1.0, p=0.03)).probability.tolist() == [0.01, 0.03]


def test_over_other_ground_it_is_less_probable_and_another_is_founded() -> None:
    found = after(taken(5.0), taken(1.0, again=0.5), taken(1.0, again=0.5))
    assert found.probability.tolist() == pytest.approx([0.0025, 0.005, 0.01])


def test_another_method_that_lies_with_the_filter_speaks_against_an_offset_no_more_than_it_may_be_wrong() -> None:
    found = after(taken(20.0, sigma_m=20.0), taken(0.0, method="structure", sigma_m=1.0, p=0.02))
    assert found.probability.tolist() == pytest.approx([0.01 * 0.02, 0.02])
    assert found.methods == ("deep", "structure")


def test_another_method_that_lies_where_the_offset_says_does_not_speak_against_it() -> None:
    found = after(taken(5.0, sigma_m=2.0), taken(-4.0, method="structure", sigma_m=2.0, p=0.02))
    assert found.probability[0] == pytest.approx(0.01)


def test_a_position_that_is_no_fix_speaks_as_another_method_does() -> None:
    found = alike.after_other(after(taken(20.0, sigma_m=20.0)), np.zeros(2), np.eye(2))
    assert found.probability[0] == pytest.approx(max(CLAIM_FLOOR, 1 / 401 * math.exp(-0.5 * found.off_m[0, 0] ** 2 / 401)) * 0.01)
    assert alike.after_other(alike.NONE, np.zeros(2), np.eye(2)) is alike.NONE


def test_what_was_founded_after_a_time_goes_with_the_fixes_that_did() -> None:
    found = after(taken(1.0, t_s=1), taken(1.0, again=0.5, t_s=2))
    assert alike.until(found, 1 * S).since_ns.tolist() == [1 * S]


LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


def fix(t_ns: int, north_m: float, east_m: float, number: int, q_ned_frd: Quat = LEVEL, footprint_m: float | None = None) -> Fix:
    place = wgs84.geo_from_ned((north_m, east_m, -HEIGHT_M), ORIGIN)
    cov = ((SIGMA_M**2, 0.0), (0.0, SIGMA_M**2))
    fixed = Fix(t_ns, t_ns, number, number, "deep", place, q_ned_frd, cov, 2.0, 0.1, CLAIM, 5.0)
    return replace(fixed, above_ground_m=HEIGHT_M, footprint_m=footprint_m)


def circled(seconds: int, leans: bool) -> list[tuple[float, float]]:
    """Error and level of who circles about a place, a height away, at which the camera looks where it `leans`; all fixes
    are wrong by the same offset."""
    radius_m, turn_radps = HEIGHT_M, 0.1
    rng, lean_rad = np.random.default_rng(3), math.radians(45.0) if leans else 0.0

    def velocity(t_s: float) -> Velocity:
        angle, speed_mps = turn_radps * t_s, turn_radps * radius_m
        v_ned_mps = -speed_mps * math.sin(angle), speed_mps * math.cos(angle), 0.0
        return Velocity(round(t_s * S), v_ned_mps, 500.0, 0.5, Drive.FED_BACK)

    belief = seeded(0, (radius_m, 0.0), START_SIGMA_M, 0.5, Drive.FED_BACK, SETTINGS)
    the_filter, found = PositionFilter(SETTINGS, ORIGIN, belief, velocity(0.0)), []
    for k in range(1, 2 * seconds + 1):
        for tenth in range(5 * k - 4, 5 * k + 1):
            the_filter.drive(velocity(tenth / 10))
        t_ns, angle = k * S // 2, turn_radps * k / 2
        north_m, east_m = radius_m * math.cos(angle), radius_m * math.sin(angle)
        noise_n, noise_e = rng.normal(0.0, SIGMA_M / 2, 2).tolist()
        inward = quat_from_euler(0.0, lean_rad, angle + math.pi)
        seen = fix(t_ns, north_m + WRONG_BY_M + noise_n, east_m + noise_e, k, inward)
        assert isinstance(the_filter.observe(seen), Accepted)
        north, east, _ = the_filter.at(t_ns).p_ned_m
        found.append((math.hypot(north - north_m, east - east_m), the_filter.protection_level_m(t_ns)))
    return found


def flown(speed_mps: float, seconds: int, wrong_by_m: float = WRONG_BY_M, stops_s: float = math.inf) -> list[tuple[float, float]]:
    """Error and level, twice a second, with a fix that is wrong by the same offset, from a place known to 15 m; east, until it
    stops."""
    rng = np.random.default_rng(3)
    start = Velocity(0, (0.0, speed_mps, 0.0), 500.0, 0.5, Drive.FED_BACK)
    belief = seeded(0, (0.0, 0.0), START_SIGMA_M, 0.5, Drive.FED_BACK, SETTINGS)
    the_filter, found = PositionFilter(SETTINGS, ORIGIN, belief, start), []
    for k in range(1, 2 * seconds + 1):
        for tenth in range(5 * k - 4, 5 * k + 1):
            v_east_mps = speed_mps if tenth <= 10 * stops_s else 0.0
            the_filter.drive(Velocity(tenth * S // 10, (0.0, v_east_mps, 0.0), 500.0, 0.5, Drive.FED_BACK))
        t_ns, true_east_m = k * S // 2, speed_mps * min(k / 2, stops_s)
        noise_n, noise_e = rng.normal(0.0, SIGMA_M / 2, 2).tolist()
        assert isinstance(the_filter.observe(fix(t_ns, wrong_by_m + noise_n, true_east_m + noise_e, k)), Accepted)
        north, east, _ = the_filter.at(t_ns).p_ned_m
        found.append((math.hypot(north, east - true_east_m), the_filter.protection_level_m(t_ns)))
    return found


def test_who_hovers_over_a_wrong_match_has_it_in_the_level_for_as_long_as_it_lasts() -> None:
    for error_m, level_m in flown(0.0, 60):
        assert 0.8 * WRONG_BY_M < error_m < level_m


def test_who_goes_on_has_a_small_level_as_soon_as_other_ground_agrees() -> None:
    levels = [level_m for _, level_m in flown(10.0, 40, wrong_by_m=0.0)]
    assert levels[1] > 30.0
    assert max(levels[-20:]) < 14.0


def test_who_then_hovers_keeps_it() -> None:
    levels = [level_m for _, level_m in flown(10.0, 100, wrong_by_m=0.0, stops_s=40)]
    assert max(levels[100:]) < 14.0


def test_who_circles_about_the_place_that_the_camera_looks_at_has_a_wrong_match_in_the_level() -> None:
    for error_m, level_m in circled(60, leans=True):
        assert 0.7 * WRONG_BY_M < error_m < level_m


def test_who_circles_and_looks_down_sees_other_ground() -> None:
    assert circled(60, leans=False)[-1][1] < WRONG_BY_M / 2


def test_a_camera_that_sees_more_looks_at_the_same_ground_for_longer() -> None:
    on_m = 20.0  # other ground to a camera of 60 degrees, which sees 72 m

    def level_m(footprint_m: float) -> float:
        start = Velocity(0, (0.0, on_m, 0.0), 500.0, 0.5, Drive.FED_BACK)
        belief = seeded(0, (0.0, 0.0), START_SIGMA_M, 0.5, Drive.FED_BACK, SETTINGS)
        the_filter = PositionFilter(SETTINGS, ORIGIN, belief, start)
        for k in range(1, 11):
            the_filter.drive(Velocity(k * S, (0.0, on_m, 0.0), 500.0, 0.5, Drive.FED_BACK))
            the_filter.observe(fix(k * S, 0.0, on_m * k, k, footprint_m=footprint_m))
        return the_filter.protection_level_m(10 * S)

    assert level_m(1500.0) > 2 * level_m(72.0)
