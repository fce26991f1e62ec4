"""How much of the computer is free."""

from __future__ import annotations

import cv2
import pytest

from visloc_companion.evaluate.demonstration.free_cores import (
    LEAST_SPEED,
    NEEDED_CORES,
    QUIET_S,
    affordable_speed,
    free_cores,
    slower,
)


def test_a_probe_gets_something_and_no_more_than_it_asks_for() -> None:
    assert 0.0 < free_cores(0.2, 1) <= 1.05


def test_speed_follows_the_cores_within_limits() -> None:
    assert affordable_speed(2.0, NEEDED_CORES) == 2.0
    assert affordable_speed(2.0, NEEDED_CORES / 2) == 1.0
    assert affordable_speed(2.0, 0.0) == LEAST_SPEED
    assert affordable_speed(0.3, 0.0) == 0.3


def test_slow_cores_are_given_time() -> None:
    """Half of a flight's CPU time takes twice as long where the search does."""
    assert affordable_speed(2.0, NEEDED_CORES, 2.0) == pytest.approx(2.0 / 1.5)
    assert affordable_speed(2.0, 2 * NEEDED_CORES, 2.0) == 2.0
    assert affordable_speed(2.0, NEEDED_CORES, 100.0) == LEAST_SPEED


@pytest.mark.parametrize(("took_s", "factor"), [(2.5 * QUIET_S, 2.5), (0.5 * QUIET_S, 1.0)])
def test_how_slow_cores_are_is_told_by_the_work_of_a_search(
    took_s: float, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cv2.getNumThreads()
    monkeypatch.setattr("visloc_companion.evaluate.demonstration.free_cores.search_work_s", lambda _: took_s)
    assert slower() == pytest.approx(factor)
    assert cv2.getNumThreads() == before
