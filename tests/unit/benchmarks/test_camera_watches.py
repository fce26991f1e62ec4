"""The flights that watches of the camera are judged on show what is wrong with it, and repeat."""

from __future__ import annotations

import pytest

from benchmarks.camera_watches import CASES, WATCHES, Case, Flight


@pytest.mark.parametrize(
    ("name", "watch"),
    [
        ("mounted 90 degrees round", "mount"),
        ("frames 0.15 s late", "time"),
        ("lens 10 % longer", "heights"),
        ("k1 of -0.15", "distortion"),
    ],
)
def test_one_fault_is_told_by_the_watch_that_is_there_for_it(name: str, watch: str) -> None:
    told = Flight("copter", CASES[name], 1).fly(50.0)
    assert watch in told
    assert set(told) <= set(WATCHES)
    assert not {"mount", "time", "heights", "distortion"} & set(told) - {watch}


def test_without_any_error_nothing_is_told_and_flights_repeat() -> None:
    first, again = (Flight("plane", Case(errors=False), 4).fly(40.0) for _ in range(2))
    assert first == again
    assert not {"mount", "time", "heights", "distortion", "lens", "zoom", "aim", "boresight"} & set(first)
