"""The factor by which a shared computer is slower."""

from __future__ import annotations

from benchmarks.machine.pace import Pace


def test_a_computer_is_never_faster_than_when_it_is_quiet() -> None:
    own = Pace()
    assert own.quiet_s > 0.0
    assert own.slower() >= 1.0


def test_times_are_stated_for_the_computer_that_is_named() -> None:
    assert Pace(quiet_s=1e6).slower() < 1e-3
    assert Pace(quiet_s=1e-9).slower() > 1.0
