from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter import fusion, lasting
from visloc_companion.core.filter.belief import Belief, Position, seeded
from visloc_companion.core.filter.motion import Motion, learned
from visloc_companion.core.filter.propagation import LASTING, LASTS, MOUNTING, POSITION, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

S = 1_000_000_000
SETTINGS = NavigatorSettings()
COV = ((4.0, 0.0), (0.0, 4.0))
NOW = ((0.01, 0.0), (0.0, 0.01))


def flown(errors_m: FloatArray, step_m: float, apart_m: float = 60.0) -> tuple[Belief, FloatArray]:
    """After fixes with these errors (N, 2), claimed as 2 m, one a second, each so many metres on, with good odometry; and the
    filter's errors after each."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 3.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.05)
    wrong = []
    for k, (north, east) in enumerate(errors_m.tolist(), 1):
        belief = fusion.propagated(belief, k * S, (step_m, 0.0), SETTINGS)
        belief, _ = learned(belief, Motion(k * S, (k - 1) * S, (step_m, 0.0), NOW), (step_m, 0.0), SETTINGS)
        fix = Position(k * S, (step_m * k + north, east), COV, from_fix=True, apart_m=apart_m)
        belief, _ = fusion.observed(belief, fix, SETTINGS)
        wrong.append(belief.x[POSITION] - (step_m * k, 0.0))
    return belief, np.array(wrong)


def alike(rng: np.random.Generator, n: int, step_m: float, apart_m: float) -> FloatArray:
    """(n, 2) errors of 2 m of which SHARE of the variance lasts."""
    keep, e = math.exp(-step_m / apart_m), rng.standard_normal(2)
    errors = np.zeros((n, 2))
    for k in range(n):
        e = keep * e + math.sqrt(1 - keep**2) * rng.standard_normal(2)
        errors[k] = 2 * (math.sqrt(lasting.SHARE) * e + math.sqrt(1 - lasting.SHARE) * rng.standard_normal(2))
    return errors


def test_a_fix_is_worth_what_it_claims() -> None:
    cov = np.array([[3.0, 1.0], [1.0, 2.0]])
    H, R = lasting.seen(cov, "deep")
    np.testing.assert_allclose(H[:, LASTING] @ H[:, LASTING].T + R, cov)
    by_shape, more = lasting.seen(cov, "structure")
    np.testing.assert_array_equal(by_shape, H)
    np.testing.assert_array_equal(more, cov)
    np.testing.assert_allclose(lasting.root_m(cov), lasting.root_m(cov).T)
    assert not lasting.root_m(np.array([[1.0, 2.0], [2.0, 1.0]])).any()
    assert not lasting.root_m(np.full((2, 2), np.nan)).any()


def test_a_vehicle_that_hovers_learns_nothing_from_many_fixes() -> None:
    belief, _ = flown(np.full((100, 2), 1.5), 0.0)
    least_m = 2 * math.sqrt(lasting.SHARE)
    assert 0.8 * least_m < math.sqrt(belief.P[0, 0]) < least_m
    moved, _ = flown(np.full((100, 2), 1.5), 15.0)
    assert moved.P[0, 0] < 0.96 * belief.P[0, 0]


def test_what_lasts_is_carried_over_and_claimed() -> None:
    """Over many draws the claim fits, and a filter that takes fixes for independent errs more and claims too little."""
    rng = np.random.default_rng(4)
    squares, claimed = [], 0.0
    for _ in range(12):
        belief, wrong = flown(alike(rng, 150, 10.0, 60.0), 10.0)
        squares.append(wrong[50:] ** 2)
        claimed = float(belief.P[0, 0])
    assert 0.7 * claimed < float(np.mean(squares)) < 1.3 * claimed


def test_fixes_taken_for_independent_would_err_more(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    errors = [alike(rng, 150, 10.0, 60.0) for _ in range(12)]
    kept = np.mean([flown(e, 10.0)[1][50:] ** 2 for e in errors])
    monkeypatch.setattr(lasting, "SHARE", 0.0)
    belief, _ = flown(errors[0], 10.0)
    independent = np.mean([flown(e, 10.0)[1][50:] ** 2 for e in errors])
    assert independent > 1.1 * kept
    assert independent > 3 * belief.P[0, 0]


def test_other_ground_may_begin_at_any_moment() -> None:
    """A fix is gated against all that it may be off by, not against what is left when the last ground's error is known."""
    belief, _ = flown(np.full((60, 2), 1.0), 10.0)
    H, R = lasting.seen(np.array(COV), "deep")
    whole = belief.P[POSITION, POSITION] + np.array(COV)
    left = H @ belief.P @ H.T + R
    assert lasting.known_m2(belief.P, H) == pytest.approx(float(np.trace(whole - left)) / 2)
    assert np.trace(left) < 0.8 * np.trace(whole)


def test_height_sets_what_is_other_ground() -> None:
    assert lasting.apart_m(100.0) == pytest.approx(100 * lasting.APART)
    assert lasting.apart_m(-5.0) == lasting.LEAST_APART_M


@pytest.mark.parametrize("ways", [0.0, 0.5, 2.0, 10.0])
def test_the_mean_of_fixes_is_off_by_what_lasts_of_their_claims_and_less_over_more_ground(ways: float) -> None:
    n, flights = 200, 4000
    rng, kept = np.random.default_rng(5), math.exp(-ways / (n - 1))
    lasts = rng.standard_normal(flights)
    total = lasts.copy()
    for _ in range(n - 1):
        lasts = kept * lasts + math.sqrt(1 - kept**2) * rng.standard_normal(flights)
        total += lasts
    drawn_m2 = lasting.SHARE * 9.0 * float(np.mean((total / n) ** 2))
    assert lasting.mean_m2(9.0, ways) == pytest.approx(drawn_m2, rel=0.08)


def circled(known_rad: float, turned_deg: float = 180.0) -> list[float]:
    """How far the filter is off at each fix, all 8 m ahead of the vehicle by its mounting, claimed as 10 m; halfway the vehicle
    turns. `known_rad`: what the filter is told of the mounting, from 1000 m."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 20.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.05)
    cov, at, off = ((100.0, 0.0), (0.0, 100.0)), np.zeros(2), list[float]()
    for k in range(1, 121):
        heading = math.radians(turned_deg if k > 60 else 0.0)
        ahead = np.array([math.cos(heading), math.sin(heading)])
        north, east = (10.0 * ahead).tolist()
        at = at + np.array([north, east])
        belief = fusion.propagated(belief, k * S, (north, east), SETTINGS)
        belief, _ = learned(belief, Motion(k * S, (k - 1) * S, (north, east), NOW), (north, east), SETTINGS)
        place = at + 8.0 * ahead
        known = {"mounting_rad": known_rad, "height_m": 1000.0}
        fix = Position(k * S, (float(place[0]), float(place[1])), cov, from_fix=True, apart_m=600.0, heading_rad=heading, **known)
        belief, _ = fusion.observed(belief, fix, SETTINGS)
        off.append(float(np.hypot(*(belief.x[POSITION] - at))))
    return off


def test_a_vehicle_that_turns_round_learns_what_its_mounting_does() -> None:
    told, untold = circled(0.0095), circled(0.0)
    assert told[59] == pytest.approx(8.0, abs=2.0), "on one heading nothing tells it"
    assert told[-1] < 1.5
    assert untold[-1] > 2.0


def after_learning(before_rad: float, now_rad: float) -> tuple[float, float]:
    """The filter's error eastwards and its 1-sigma, hovering where fixes said 8 m east and claimed 10 m, and say nothing east and
    claim 5 m since the mounting is known better."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 20.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.05)
    for k in range(1, 81):
        belief = fusion.propagated(belief, k * S, (0.0, 0.0), SETTINGS)
        belief, _ = learned(belief, Motion(k * S, (k - 1) * S, (0.0, 0.0), NOW), (0.0, 0.0), SETTINGS)
        off_m, claim_m, known_rad = (8.0, 10.0, before_rad) if k <= 40 else (0.0, 5.0, now_rad)
        cov = ((claim_m**2, 0.0), (0.0, claim_m**2))
        known = {"mounting_rad": known_rad, "height_m": 1000.0}
        fix = Position(k * S, (0.0, off_m), cov, from_fix=True, apart_m=600.0, heading_rad=0.0, **known)
        belief, _ = fusion.observed(belief, fix, SETTINGS)
    return float(belief.x[1]), math.sqrt(belief.P[1, 1])


def test_what_was_learned_of_a_mounting_was_another_error_than_what_is_left() -> None:
    """Fixes that come 8 m nearer and claim half of it are right as they claim; the same error in smaller 1-sigmas would put the
    vehicle another 8 m beyond them."""
    east_m, sigma_m = after_learning(0.0095, 0.0045)
    assert abs(east_m) < 2.5
    assert 3.5 < sigma_m < 5.5
    assert after_learning(0.0, 0.0)[0] < -4.0


def test_no_fix_claims_less_than_its_mounting_makes() -> None:
    cov = 4.0 * np.eye(2)
    H, R = lasting.seen(cov, "deep", mounting=lasting.Mounting(5.0, 0.7))
    np.testing.assert_allclose(H[:, MOUNTING] @ H[:, MOUNTING].T, 25.0 * np.eye(2), atol=1e-12)
    assert np.linalg.eigvalsh(R)[0] > 0
    wide, new = lasting.seen(100.0 * np.eye(2), "deep", mounting=lasting.Mounting(5.0, 0.7))
    lasts = wide[:, LASTS]
    np.testing.assert_allclose(lasts @ lasts.T + new, 100.0 * np.eye(2), atol=1e-9)
    assert new[0, 0] == pytest.approx(lasting.NEW_M**2)
