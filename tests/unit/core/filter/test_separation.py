from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.filter import fusion, separation
from visloc_companion.core.filter.belief import Belief, Position, seeded, widened_by
from visloc_companion.core.filter.propagation import N_STATES, POSITION, VELOCITY, Drive, step
from visloc_companion.core.filter.separation import CLAIM_FLOOR, CORRELATION, EVERY, ONE
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Accepted, FloatArray

S = 1_000_000_000
SETTINGS = NavigatorSettings()
COV = ((1.0, 0.0), (0.0, 1.0))


def start(drive: Drive = Drive.FED_BACK) -> Belief:
    return seeded(0, (0.0, 0.0), 2.0, 0.3, drive, SETTINGS)


def taken(belief: Belief, t_s: float, north_m: float, method: str = "deep", p: float = 0.01, from_fix: bool = True) -> Belief:
    at = Position(round(t_s * S), (north_m, 0.0), COV, from_fix, method, p)
    moved = fusion.propagated(belief, at.t_ns, (0.0, 0.0), SETTINGS)
    after, outcome = fusion.observed(moved, at, SETTINGS)
    assert isinstance(outcome, Accepted)
    return after


def by_kind(belief: Belief, kind: str) -> list[tuple[float, float]]:
    """Probability and north of the solutions of a kind, oldest first."""
    w = belief.without
    return [(float(w.probability[k]), float(w.x[k, 0])) for k in range(len(w)) if w.leaves[k] == kind]


def test_without_its_only_fix_the_position_is_what_it_was_before() -> None:
    before = fusion.propagated(start(), S, (0.0, 0.0), SETTINGS)
    after = taken(start(), 1.0, 3.0)
    (alone,) = by_kind(after, EVERY)
    assert alone == (0.01, 0.0)
    assert after.without.P[0] == pytest.approx(before.P)
    assert after.x[0] > 1.0


def test_solutions_move_and_spread_as_a_filter_that_never_had_the_fix() -> None:
    without = fusion.propagated(start(), 5 * S, (4.0, -1.0), SETTINGS)
    after = fusion.propagated(taken(start(), 0.0, 1.0), 5 * S, (4.0, -1.0), SETTINGS)
    w = after.without
    assert len(w) == 2
    np.testing.assert_allclose(w.x[0], without.x)
    np.testing.assert_allclose(w.P[0], without.P, rtol=1e-9)


def test_one_that_takes_the_later_fixes_is_the_filter_without_the_first() -> None:
    only_second = taken(start(), 1.0, 0.2)
    both = taken(taken(start(), 0.0, 1.5), 1.0, 0.2)
    w = both.without
    one = w.leaves.index(ONE)
    np.testing.assert_allclose(w.x[one], only_second.x, atol=1e-12)
    np.testing.assert_allclose(w.P[one], only_second.P, rtol=1e-9)


def test_a_method_errs_again_more_often_than_at_first_and_other_methods_independently() -> None:
    belief = taken(taken(start(), 0.0, 0.0, p=0.01), 1.0, 0.0, p=0.004)
    assert by_kind(belief, EVERY)[0][0] == pytest.approx(0.01 * CORRELATION)
    belief = taken(belief, 2.0, 0.0, "structure", 0.02)
    assert by_kind(belief, EVERY)[0][0] == pytest.approx(0.01 * CORRELATION * 0.02)
    assert by_kind(belief, "structure") == [(0.02, pytest.approx(by_kind(belief, EVERY)[-1][1]))]


def test_a_vote_left_out_takes_the_other_votes_fixes() -> None:
    belief = taken(taken(start(), 0.0, 0.0, "structure"), 1.0, 3.0, "deep")
    after = taken(belief, 2.0, 0.0, "structure")
    k = after.without.leaves.index("deep")
    alone = taken(taken(start(), 0.0, 0.0, "structure"), 2.0, 0.0, "structure")
    np.testing.assert_allclose(after.without.x[k], alone.x, atol=1e-12)
    assert after.without.rested_ns[k] == 2 * S


def test_gnss_is_taken_by_all_and_founds_none() -> None:
    belief = taken(start(), 0.0, 3.0)
    after = taken(belief, 1.0, 0.0, from_fix=False)
    assert len(after.without) == len(belief.without)
    assert np.trace(after.without.P[0, :2, :2]) < np.trace(belief.without.P[0, :2, :2])


def test_no_claim_is_believed_below_the_floor_and_none_above_one() -> None:
    assert by_kind(taken(start(), 0.0, 0.0, p=0.0), EVERY)[0][0] == CLAIM_FLOOR
    assert by_kind(taken(start(), 0.0, 0.0, p=5.0), EVERY)[0][0] == 1.0


def test_there_are_never_too_many_and_the_improbable_go_first() -> None:
    belief = start()
    for k in range(80):
        belief = taken(belief, 0.1 * k, 0.3 * (-1) ** k, p=0.5)
    w = belief.without
    assert len(w) <= separation.MAX_SOLUTIONS
    assert w.probability.min() >= separation.NEGLIGIBLE
    assert w.leaves.count(EVERY) > 5
    assert np.isfinite(w.x).all()
    assert (np.linalg.eigvalsh(w.P) > 0).all()


def test_a_new_velocity_leaves_no_learned_error() -> None:
    belief = taken(taken(start(Drive.AUTOPILOT), 0.0, 0.0), 3.0, 2.0)
    other = fusion.with_velocity_trust(belief, 0.8, Drive.FED_BACK)
    assert (other.without.x[:, VELOCITY] == 0).all()
    np.testing.assert_allclose(other.without.P[:, VELOCITY.start, VELOCITY.start], 0.64)
    assert (other.without.P[:, POSITION, VELOCITY] == 0).all()
    wider = fusion.with_velocity_trust(other, 1.0, Drive.FED_BACK)
    np.testing.assert_allclose(wider.without.P[:, VELOCITY.start + 1, VELOCITY.start + 1], 1.0)


def test_the_origin_moves_them_along() -> None:
    w = taken(start(), 0.0, 3.0).without
    moved = separation.shifted(w, np.array([5.0, -2.0]))
    np.testing.assert_allclose(moved.x - w.x, np.tile([5.0, -2.0, *[0.0] * (N_STATES - 2)], (len(w), 1)))
    assert separation.shifted(separation.NONE, np.array([5.0, -2.0])) is separation.NONE


def test_what_a_filter_was_before_it_started_anew_stays_a_solution() -> None:
    belief = start()
    for k in range(SETTINGS.relocalise_after_rejections):
        at = Position(round((0.5 + 0.2 * k) * S), (60.0, 0.0), COV, from_fix=True, method="deep", probability_wrong=0.01)
        belief = fusion.propagated(belief, at.t_ns, (0.0, 0.0), SETTINGS)
        belief, outcome = fusion.observed(belief, at, SETTINGS)
    assert isinstance(outcome, Accepted)
    assert belief.x[0] == 60.0
    assert min(abs(north) for _, north in by_kind(belief, EVERY)) < 1e-9


def test_only_those_that_say_nothing_of_their_own_are_merged() -> None:
    w = taken(start(), 0.0, 3.0).without
    x, P = w.x[0], w.P[0]
    kept = separation.apart(w, x, P)
    assert kept.leaves == (EVERY,)
    assert len(separation.apart(replace(w, x=w.x + math.sqrt(np.trace(P[:2, :2]))), x, P)) == 2
    assert separation.apart(kept, x, P) is kept


@pytest.mark.parametrize("drive", list(Drive))
def test_covariances_that_are_carried_on_when_asked_for_are_those_of_every_step(drive: Drive) -> None:
    """Fixes that some solutions leave out, then steps of a second, of which one widens all, with velocities that turn."""
    belief = start(drive)._replace(lens_share=0.01)
    for k in range(1, 4):
        belief = taken(belief, k, 1.0 * k, "deep" if k % 2 else "structure")
    belief = belief._replace(without=replace(belief.without, x=belief.without.x + 0.5))
    P, more = belief.without.P, np.diag(np.arange(1.0, N_STATES + 1))
    for k in range(12):
        x, change = belief.without.x, (0.3 * k, -0.2)
        sigmas = [own_sigma_mps(belief, int(rested), mean) for rested, mean in zip(belief.without.rested_ns, x, strict=True)]
        gone_by = math.hypot(8.0, 3.0) / belief.apart_m
        on = step(1.0, drive, belief.sigma_a_mps2, change, SETTINGS, gone_by, belief.lens_share)
        P = on.F @ P @ on.F.T + on.Q + np.square(sigmas)[:, None, None] * on.V
        belief = fusion.propagated(belief, belief.t_ns + S, (8.0, 3.0), SETTINGS, change)
        if k == 5:
            P, belief = P + more, widened_by(belief, more)
    np.testing.assert_allclose(belief.without.P, P, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(belief.without.position_m2.T.reshape(-1, 2, 2), P[:, POSITION, POSITION], rtol=1e-9)
    later = replace(belief.without, then=belief.without.P, way=None)
    np.testing.assert_allclose(later.position_m2, belief.without.position_m2, rtol=1e-9)


@pytest.mark.parametrize(("first", "then"), [(Drive.INERTIAL, Drive.FED_BACK), (Drive.FED_BACK, Drive.INERTIAL)])
def test_what_each_has_of_its_own_velocity_begins_and_ends_with_that_velocity(first: Drive, then: Drive) -> None:
    belief = taken(start(first), 1.0, 1.0)
    P = belief.without.P
    for drive in (first, then, then):
        belief = belief._replace(drive=drive)
        on = step(1.0, drive, belief.sigma_a_mps2, (0.0, 0.0), SETTINGS, 5.0 / belief.apart_m, belief.lens_share)
        sigmas = [own_sigma_mps(belief, int(n), x) for n, x in zip(belief.without.rested_ns, belief.without.x, strict=True)]
        P = on.F @ P @ on.F.T + on.Q + np.square(sigmas)[:, None, None] * on.V
        belief = fusion.propagated(belief, belief.t_ns + S, (4.0, 3.0), SETTINGS)
    np.testing.assert_allclose(belief.without.P, P, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(belief.without.position_m2.T.reshape(-1, 2, 2), P[:, POSITION, POSITION], rtol=1e-9)


def own_sigma_mps(belief: Belief, rested_ns: int, x: FloatArray) -> float:
    """1-sigma of the velocity's error in a solution that rests on a fix of that time."""
    if belief.drive is Drive.INERTIAL:
        return 0.0
    if belief.drive is not Drive.FED_BACK:
        return max(belief.sigma_v_mps, math.hypot(*x[VELOCITY]) / 2)
    unheld_s = max(0.0, (belief.t_ns - max(rested_ns, belief.started_ns)) * 1e-9 - SETTINGS.dead_reckoning_after_s)
    return (belief.sigma_v_mps + fusion.INERTIAL_DRIFT_MPS2 * unheld_s) * math.sqrt(belief.fed_back_over)


@pytest.mark.parametrize("n_considered", [0, 1, 11])
@pytest.mark.parametrize("m", [1, 2])
def test_an_update_of_solutions_is_josephs_form_of_each(m: int, n_considered: int) -> None:
    rng = np.random.default_rng(3)
    root, x = rng.standard_normal((4, N_STATES, N_STATES)), rng.standard_normal((4, N_STATES))
    P = root @ root.transpose(0, 2, 1)
    H, z, R = rng.standard_normal((m, N_STATES)), rng.standard_normal(m), 0.5 * np.eye(m)
    before = separation.Solutions(x, P, np.full(4, 0.1), np.zeros(4, np.int64), (ONE,) * 4, (frozenset(),) * 4)
    take = np.array([True, False, True, True])
    after = separation.updated(before, z, R, H, take=take, n_considered=n_considered)
    for k in range(4):
        gain = P[k] @ H.T @ np.linalg.inv(H @ P[k] @ H.T + R)
        gain[N_STATES - n_considered :] = 0.0
        keep = np.eye(N_STATES) - gain @ H
        expected = (x[k] + gain @ (z - H @ x[k]), keep @ P[k] @ keep.T + gain @ R @ gain.T) if take[k] else (x[k], P[k])
        np.testing.assert_allclose(after.x[k], expected[0], atol=1e-9)
        np.testing.assert_allclose(after.P[k], expected[1], atol=1e-9)
        np.testing.assert_array_equal(after.P[k], after.P[k].T)


@pytest.mark.parametrize("taking", [(True, True), (True, False)])
@pytest.mark.parametrize("carried_on", [False, True])
def test_an_update_leaves_the_solutions_before_as_they_were(taking: tuple[bool, bool], carried_on: bool) -> None:
    """What was folded before a late fix is folded on from again."""
    before = taken(start(), 1.0, 0.5).without
    if carried_on:
        on = step(0.1, Drive.FED_BACK, 0.1, (0.0, 0.0), SETTINGS)
        before = separation.propagated(before, on, on.Q, None, np.zeros(N_STATES))
    x, P = before.x.copy(), before.P.copy()
    H, R = np.eye(2, N_STATES), np.eye(2)
    after = separation.updated(before, np.ones(2), R, H, take=np.array(taking), n_considered=0)
    np.testing.assert_array_equal(before.x, x)
    np.testing.assert_array_equal(before.P, P)
    assert (after.P[0] != P[0]).any()
    assert (after.P[1] == P[1]).all() == (not taking[1])
