from __future__ import annotations

import pytest

from visloc_companion.core.places.travel import TravelLog
from visloc_companion.types import Odometry

S = 1_000_000_000


def test_velocity_is_integrated_and_held() -> None:
    log = TravelLog()
    for k in range(11):
        log.velocity(k * S, (float(k), 2.0))
    travel = log.between(2 * S, 4 * S)
    assert travel.moved_ne_m == pytest.approx((6.0, 4.0))
    assert travel.by_velocity
    assert travel.dt_s == 2.0
    assert log.between(round(2.5 * S), 3 * S).moved_ne_m == pytest.approx((1.25, 1.0), abs=0.1)
    assert log.between(10 * S, 12 * S).moved_ne_m == pytest.approx((20.0, 4.0))
    assert log.between(12 * S, 10 * S).dt_s == 0.0


def test_nothing_is_known_before_the_first_velocity() -> None:
    assert TravelLog().between(0, S).moved_ne_m == (0.0, 0.0)
    log = TravelLog()
    log.velocity(10 * S, (5.0, 0.0))
    assert log.between(8 * S, 10 * S).moved_ne_m == pytest.approx((10.0, 0.0))


def test_old_samples_go() -> None:
    log = TravelLog()
    for k in range(200):
        log.velocity(k * S, (1.0, 0.0))
        log.velocity(k * S + 1, (99.0, 0.0))  # hardly newer
    assert log.between(190 * S, 199 * S).moved_ne_m == pytest.approx((9.0, 0.0))


def test_odometry_is_better_where_it_covers_the_time() -> None:
    log = TravelLog()
    for k in range(5):
        log.velocity(k * S, (10.0, 0.0))
        log.odometry(Odometry(0, k * S, (k + 1) * S, (12.0, 1.0, 0.0), ((0.1, 0.0), (0.0, 0.1))))
    seen = log.between(S, 3 * S)
    assert not seen.by_velocity
    assert seen.moved_ne_m == pytest.approx((24.0, 2.0))
    assert log.between(S, 9 * S).by_velocity


def test_odometry_that_did_not_see_much_of_the_time_is_not() -> None:
    """Two displacements with a hole of two seconds between them."""
    log = TravelLog()
    for k in range(7):
        log.velocity(k * S, (10.0, 0.0))
    for k in (0, 1, 4, 5):
        log.odometry(Odometry(0, k * S, (k + 1) * S, (12.0, 1.0, 0.0), ((0.1, 0.0), (0.0, 0.1))))
    assert log.between(S, 5 * S).moved_ne_m == pytest.approx((40.0, 0.0))
    assert log.between(S, 5 * S).by_velocity
    assert not log.between(4 * S, 6 * S).by_velocity


def test_displacements_of_another_log_count_as_its_own_would() -> None:
    own, first = TravelLog(), TravelLog()
    second = TravelLog(first.displacements)
    for k in range(5):
        seen = Odometry(0, k * S, (k + 1) * S, (12.0, 1.0 * k, 0.0), ((0.1, 0.0), (0.0, 0.1)), 0.02)
        own.odometry(seen)
        first.odometry(seen)
    assert second.between(S, 4 * S) == own.between(S, 4 * S)
