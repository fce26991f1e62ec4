"""How much of the computer is free."""

from __future__ import annotations

from visloc_companion.evaluate.free_cores import LEAST_SPEED, NEEDED_CORES, affordable_speed, free_cores


def test_a_probe_gets_something_and_no_more_than_it_asks_for() -> None:
    assert 0.0 < free_cores(0.2, 1) <= 1.05


def test_speed_follows_the_cores_within_limits() -> None:
    assert affordable_speed(2.0, NEEDED_CORES) == 2.0
    assert affordable_speed(2.0, NEEDED_CORES / 2) == 1.0
    assert affordable_speed(2.0, 0.0) == LEAST_SPEED
    assert affordable_speed(0.3, 0.0) == 0.3
