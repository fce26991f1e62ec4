"""Fixes that are wrong by the same offset over the same ground: the level holds until the vehicle has gone on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core import kalman
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import alike
from visloc_companion.core.filter.alike import Alike, Taken
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.filter.separation import CLAIM_FLOOR
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Accepted, Fix, FloatArray, GeoPoint, Quat

S_NS = 1_000_000_000
ORIGIN = GeoPoint(47.4, 8.5, 400.0)
SETTINGS = NavigatorSettings()
HEIGHT_M, SIGMA_M, CLAIM = 60.0, 1.0, 0.004
START_SIGMA_M, WRONG_BY_M = 15.0, 25.0


H = np.eye(2)


def taken(north_m: float, p: float = 0.01, again: float = 1.0, method: str = "deep", sigma_m: float = 3.0, t_s: int = 0) -> Taken:
    """A fix of 1-sigma 1 m so far north of a filter that knows its place to `sigma_m`, and nothing else."""
    P = sigma_m**2 * np.eye(2)
    S = P + np.eye(2)
    return Taken(t_s * S_NS, method, p, again, np.array([north_m, 0.0]), S, H, P @ np.linalg.inv(S))


def after(*fixes: Taken) -> Alike:
    found = alike.none(2, 2)
    for fix in fixes:
        found = alike.after_fix(found, fix)
    return found


def off_by(found: Alike, H: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By how much H x, H (l, n), is off, mean (K, l), and the covariance (K, l, l) of that beside the filter's own."""
    off_m, (first, last, both) = found.off_m(H)
    return off_m.T, np.array([[first, both], [both, last]])[: len(H), : len(H)].transpose(2, 0, 1)


@given(st.integers(0, 2**32), st.sampled_from([1, 2]), st.sampled_from([1, 2]))
def test_how_far_it_is_off_is_what_the_inverse_of_the_information_says(seed: int, rows: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    K, n = int(rng.integers(0, 6)), 4
    roots, by, told, seen = (rng.normal(size=size) for size in ((K, m, m), (n, K, m), (K, m), (rows, n)))
    information = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(m)
    many = Alike(by, information, told, np.zeros(K), np.zeros(K, np.int64), ("deep",) * K)
    off_m, spread_m2 = off_by(many, seen)
    for k in range(K):
        each, inverse = seen @ by[:, k], np.linalg.inv(information[k])
        np.testing.assert_allclose(off_m[k], each @ inverse @ told[k], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(spread_m2[k], each @ inverse @ each.T, rtol=1e-9, atol=1e-9)


def test_a_fix_founds_what_it_moved_the_filter_by_known_as_the_filter_was() -> None:
    found = after(taken(5.0))
    off_m, spread_m2 = off_by(found, H)
    assert off_m[0].tolist() == pytest.approx([4.5, 0.0])
    assert spread_m2[0] + 0.9 * np.eye(2) == pytest.approx(9.0 * np.eye(2))  # 0.9: what the filter claims with the fix
    assert found.probability.tolist() == [0.01]
    assert after(taken(5.0, p=1e-7)).probability.tolist() == [CLAIM_FLOOR]


def test_over_the_same_ground_it_stays_as_probable_and_nearly_all_of_it_is_followed() -> None:
    found = after(taken(5.0), *[taken(0.5), taken(0.05), *[taken(0.0)] * 18])
    assert len(found) == 1
    assert found.probability.tolist() == [0.01]
    assert off_by(found, H)[0][0, 0] == pytest.approx(5.0, rel=1e-3)


CONSTANT_VELOCITY = np.array([[1.0, 0.5], [0.0, 1.0]])
PLACE, SPEED = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])


def folded(fixes_m: FloatArray, speeds_mps: FloatArray | None = None) -> tuple[FloatArray, FloatArray, Alike]:
    """Mean, covariance and offsets of a filter of place and velocity on a line, after fixes of 1-sigma 1 m, 0.5 s apart, and
    velocities of 0.2 m/s; an offset is founded by the first fix from FROM on, which alone looks at other ground."""
    x, P, found = np.zeros(2), np.diag([4.0, 1.0]), alike.none(2, 1)
    F, Q, R = CONSTANT_VELOCITY, np.diag([0.01, 0.02]), np.eye(1)
    for k, fix_m in enumerate(fixes_m):
        x, P, found = F @ x, F @ P @ F.T + Q, alike.carried(found, F)
        innovation_m, S, gain = np.array([fix_m]) - PLACE @ x, PLACE @ P @ PLACE.T + R, kalman.gain(P, R, PLACE)
        if k >= FROM:
            found = alike.after_fix(found, Taken(k * S_NS, "deep", 0.01, 1.0, innovation_m, S, PLACE, gain))
        x, P = x + gain @ innovation_m, (np.eye(2) - gain @ PLACE) @ P
        if speeds_mps is not None:
            seen, R_v = np.array([speeds_mps[k]]) - SPEED @ x, 0.04 * np.eye(1)
            gain = kalman.gain(P, R_v, SPEED)
            found = alike.measured(found, seen, SPEED @ P @ SPEED.T + R_v, SPEED, gain)
            x, P = x + gain @ seen, (np.eye(2) - gain @ SPEED) @ P
    return x, P, found


FROM, N_FIXES = 10, 18


def test_the_velocity_that_a_run_of_wrong_fixes_teaches_is_in_it() -> None:
    """The filter is linear: with fixes off by 6 m from one of them on it is off by as much more as each metre makes, in place and
    in velocity; what they moved its place by is another amount."""
    rng = np.random.default_rng(5)
    right_m = rng.normal(0.0, 1.0, N_FIXES)
    wrong_m = right_m + 6.0 * (np.arange(N_FIXES) >= FROM)
    (led, _, found), (straight, _, _) = folded(wrong_m), folded(right_m)
    assert found.by[:, 0, 0] * 6.0 == pytest.approx(led - straight)
    assert led[1] - straight[1] > 0.5


@pytest.mark.parametrize("odometry", [False, True])
def test_how_far_the_filter_is_off_is_known_as_well_as_it_says(odometry: bool) -> None:
    """Over 2,000 flights whose truth and fixes are drawn from the filter's own model, with any offset: the normalised squared
    error of the place without it is 1 in the mean."""
    rng, squares = np.random.default_rng(6), []
    for _ in range(2000):
        truth, states = np.array([2.0, 1.0]) * rng.standard_normal(2), []
        for _ in range(N_FIXES):
            truth = CONSTANT_VELOCITY @ truth + np.array([0.1, math.sqrt(0.02)]) * rng.standard_normal(2)
            states.append(truth)
        places, speeds = np.array(states).T
        seen_m = places + rng.standard_normal(N_FIXES) + rng.uniform(-20, 20) * (np.arange(N_FIXES) >= FROM)
        told = speeds + 0.2 * rng.standard_normal(N_FIXES) if odometry else None
        x, P, found = folded(seen_m, told)
        off_m, spread_m2 = off_by(found, PLACE)
        squares.append((x[0] - off_m[0, 0] - truth[0]) ** 2 / (P[0, 0] + spread_m2[0, 0, 0]))
    assert float(np.mean(squares)) == pytest.approx(1.0, abs=3 * math.sqrt(2 / 2000))


def test_odometry_tells_what_the_filter_has_followed() -> None:
    """A velocity that the filter has from the offset alone: where odometry says that there is none, the offset is the larger for
    it and better known, and where it finds the filter right there is the less of it."""
    before = folded(6.0 * (np.arange(N_FIXES) >= FROM))[2]
    S, gain, half = 0.1 * np.eye(1), np.zeros((2, 1)), off_by(before, SPEED)[0][0] / 2
    right, wrong = alike.measured(before, 0 * half, S, SPEED, gain), alike.measured(before, -4 * half, S, SPEED, gain)
    assert off_by(wrong, PLACE)[1][0, 0, 0] < off_by(before, PLACE)[1][0, 0, 0]
    assert off_by(right, PLACE)[0][0, 0] < off_by(before, PLACE)[0][0, 0] < off_by(wrong, PLACE)[0][0, 0]


def test_a_state_that_stands_for_something_else_is_off_by_none() -> None:
    found = folded(np.full(N_FIXES, 6.0))[2]
    assert alike.renewed(found, slice(1, 2)).by[:, 0, 0].tolist() == [found.by[0, 0, 0], 0.0]


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
    before = after(taken(20.0, sigma_m=20.0))
    position = Taken(0, "", 0.0, 1.0, np.zeros(2), np.eye(2), H, np.zeros((2, 2)))
    found, ((off_m, _),) = alike.after_other(before, position), off_by(before, H)[0]
    wider = 1 + float(off_by(before, H)[1][0, 0, 0])
    assert found.probability[0] == pytest.approx(max(CLAIM_FLOOR, 1 / wider * math.exp(-0.5 * off_m**2 / wider)) * 0.01)
    nothing = alike.none(2, 2)
    assert alike.after_other(nothing, position) is nothing


def test_what_was_founded_after_a_time_goes_with_the_fixes_that_did() -> None:
    found = after(taken(1.0, t_s=1), taken(1.0, again=0.5, t_s=2))
    assert alike.until(found, 1 * S_NS).since_ns.tolist() == [1 * S_NS]


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
        return Velocity(round(t_s * S_NS), v_ned_mps, 500.0, 0.5, Drive.FED_BACK)

    belief = seeded(0, (radius_m, 0.0), START_SIGMA_M, 0.5, Drive.FED_BACK, SETTINGS)
    the_filter, found = PositionFilter(SETTINGS, ORIGIN, belief, velocity(0.0)), []
    for k in range(1, 2 * seconds + 1):
        for tenth in range(5 * k - 4, 5 * k + 1):
            the_filter.drive(velocity(tenth / 10))
        t_ns, angle = k * S_NS // 2, turn_radps * k / 2
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
            the_filter.drive(Velocity(tenth * S_NS // 10, (0.0, v_east_mps, 0.0), 500.0, 0.5, Drive.FED_BACK))
        t_ns, true_east_m = k * S_NS // 2, speed_mps * min(k / 2, stops_s)
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
            the_filter.drive(Velocity(k * S_NS, (0.0, on_m, 0.0), 500.0, 0.5, Drive.FED_BACK))
            the_filter.observe(fix(k * S_NS, 0.0, on_m * k, k, footprint_m=footprint_m))
        return the_filter.protection_level_m(10 * S_NS)

    assert level_m(1500.0) > 2 * level_m(72.0)
