"""What the benchmark of a camera's own time stamps computes itself."""

from __future__ import annotations

import pytest

from benchmarks.camera_stamps import Moment, flown, row


def test_a_copters_stamps_are_corrected_within_seconds() -> None:
    moments = flown("copter", "straight", "usual", 1, 12.0, -0.06)
    assert moments[0].moved_s == 0.0
    assert moments[-1].moved_s == pytest.approx(-0.06, abs=0.01)
    assert sum(m.told for m in moments) == 1


def test_figures_of_a_false_claim_and_of_one_that_is_true() -> None:
    false = [Moment(0.0, 0.0, 0.6, 0.0, False), Moment(1.0, 0.06, 0.008, 0.06, True)]
    true = [Moment(0.0, 0.0, 0.6, 0.0, False), Moment(1.0, 0.01, 0.008, 0.0, False)]
    assert row([false, true], 0.0) == "50.0 % | 25.0 % | 25.0 % | 1 | 1, 1 s, 1 never | –"
    assert row([false, true], 0.06) == "50.0 % | 25.0 % | 0.0 % | 0 | 1, 1 s, 1 never | 1, 1 s, 1 never"
