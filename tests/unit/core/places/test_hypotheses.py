"""Places held against answers until one is left."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.core.places import hypotheses as hy
from visloc_companion.core.places.hypotheses import Travel

S = 1_000_000_000
COV = ((4.0, 0.0), (0.0, 4.0))


def north(metres: float, dt_s: float) -> Travel:
    return Travel((metres, 0.0), ((0.05 * dt_s, 0.0), (0.0, 0.05 * dt_s)), dt_s, by_velocity=True)


def flown(
    n: int, spacing_m: float = 30.0, step_m: float = 40.0, truth_m: float = 40.0, number: int = 1, sure: bool = False
) -> hy.Hypothesis:
    """After n fixes, each `truth_m` further on where the velocity input says `step_m`."""
    h = hy.born(number, 0, (0.0, 0.0), 12.0, 3.0)
    for k in range(n):
        h = hy.carried(h, (k + 1) * 4 * S, north(step_m, 4.0))
        h = hy.confirmed(h, (truth_m * (k + 1), 0.0), COV, spacing_m, sure)
    return h


def test_agreeing_answers_add_up_to_the_risk_that_is_stated() -> None:
    assert hy.winner([flown(3)], 1e-5) is None
    best = flown(4)
    assert hy.winner([best], 1e-5) is best
    wrong = hy.probability_wrong(best, [best])
    assert wrong == pytest.approx(1 / (1 + (hy.SEEN / hy.SEEN_BY_MISTAKE) ** 4 / 40))
    assert wrong <= 1e-5


def test_sure_answers_are_fewer_and_no_riskier() -> None:
    best = flown(3, sure=True)
    assert hy.winner([best], 1e-5, swept=True) is best
    assert hy.winner([best], 1e-5) is None  # what looks the same may not have been looked at
    assert hy.winner([flown(3)], 1.0, swept=True) is None
    assert hy.winner([flown(2, sure=True)], 1.0, swept=True) is None
    assert hy.probability_wrong(best, [best]) == pytest.approx(1 / (1 + (hy.SEEN / hy.SURE_BY_MISTAKE) ** 3 / 40))


def test_the_error_of_the_velocity_is_learnt() -> None:
    """The input says 10 m/s, the vehicle flies 12."""
    h = flown(4, truth_m=48.0)
    assert h.hits == 4
    assert h.velocity_error_mps[0] == pytest.approx(-2.0, abs=0.3)
    assert h.place_ne_m[0] == pytest.approx(192.0, abs=2.0)
    assert math.sqrt(h.cov_ne_m2[0][0]) < 3.0


def test_an_answer_where_the_motion_does_not_lead_is_a_miss() -> None:
    before = flown(3)
    after = hy.confirmed(hy.carried(before, 16 * S, north(40.0, 4.0)), (160.0, 90.0), COV, 30.0)
    assert after.hits == 3
    assert after.log_odds == pytest.approx(before.log_odds + hy.MISS)


def test_a_vehicle_that_stands_is_never_found() -> None:
    """The same ground again says nothing new."""
    h = flown(20, step_m=0.0, truth_m=0.0)
    assert h.hits == 1
    assert hy.winner([h], 1e-5) is None


def test_a_double_that_gains_as_much_is_not_believed() -> None:
    """A pattern that repeats itself: each answer fits both places."""
    a = flown(12)
    for n in (1, 4, 12):  # that it was asked about less often does not speak against it
        b = replace(flown(n, number=2), x=a.x + np.array([500.0, 0.0, 0.0, 0.0]))
        assert hy.probability_wrong(a, [a, b]) > 0.49
        assert hy.winner([a, b], 1e-5) is None


def test_what_was_seen_once_and_then_no_more_is_no_double() -> None:
    a, b = flown(6), flown(1, number=2)
    for k in range(3):
        b = hy.missed(replace(b, t_ns=(10 + 3 * k) * S))
    assert hy.winner([a, b], 1e-5) is a


def test_misses_count_once_in_a_while_and_end_a_hypothesis() -> None:
    h = hy.missed(hy.missed(hy.born(1, 0, (0.0, 0.0), 12.0, 3.0)))
    assert h.log_odds == pytest.approx(hy.FIRST_LOG_ODDS + hy.MISS)
    assert hy.kept([h])
    assert hy.kept([hy.missed(hy.carried(h, 3 * S, north(30.0, 3.0)))]) == ()


def test_what_says_nothing_changes_no_odds() -> None:
    h = hy.untold(flown(2))
    assert (h.log_odds, h.hits, h.tested_ns) == (flown(2).log_odds, 2, h.t_ns)


def test_one_place_is_kept_once_and_the_best_come_first() -> None:
    known = flown(2)
    x, y = known.place_ne_m
    again = hy.born(7, known.t_ns, (x + 10.0, y - 5.0), 12.0, 3.0)
    other = hy.born(8, known.t_ns, (x + 400.0, y), 12.0, 3.0)
    assert [h.number for h in hy.kept([again, other, known])] == [1, 8]
    many = [hy.born(k, 0, (100.0 * k, 0.0), 5.0, 3.0) for k in range(hy.MOST + 5)]
    assert len(hy.kept(many)) == hy.MOST


def test_odometry_leaves_the_velocity_alone() -> None:
    h = hy.carried(flown(2), 12 * S, Travel((40.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 4.0, by_velocity=False))
    assert h.P[0, 0] == pytest.approx(flown(2).P[0, 0] + 1.0)  # nothing of the velocity's error
    assert h.velocity_error_mps == flown(2).velocity_error_mps
