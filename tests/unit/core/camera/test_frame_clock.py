"""An even clock behind uneven arrivals."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from visloc_companion.core.camera.frame_clock import SETTLED_FRAMES, FrameClock

MS = 1_000_000


def arrived(
    clock: FrameClock, period_ms: float, n: int, jitter_ms: float, seed: int = 1, first: int = 0, skip: int = 0
) -> list[float]:
    """Errors of the times given (ms) of frames taken each `period_ms` from `first` + `skip` on."""
    rng = Random(seed)
    errors = []
    for k in range(first, first + n):
        taken_ms = period_ms * (k + skip)
        late_ms = 150.0 + rng.uniform(-jitter_ms, jitter_ms)
        given = clock.on_arrival(round((1000 + taken_ms + late_ms) * MS), k)
        errors.append(given.t_ns / MS - 1150 - taken_ms)
    return errors


@pytest.mark.parametrize(("period_ms", "jitter_ms"), [(200.0, 80.0), (33.3, 15.0), (100.0, 30.0)])
def test_jitter_is_averaged_away(period_ms: float, jitter_ms: float) -> None:
    ratios = []
    for seed in range(12):
        clock = FrameClock()
        errors = arrived(clock, period_ms, 300, jitter_ms, seed)
        assert np.abs(errors[-100:]).mean() < 0.25 * jitter_ms
        ratios.append(errors[-1] / (1e3 * clock.on_arrival(round((1150 + 300 * period_ms + 1000) * MS), 300).sigma_s))
    assert 0.4 < float(np.sqrt(np.mean(np.square(ratios)))) < 2.0


def test_the_first_arrivals_stand() -> None:
    clock = FrameClock()
    t = [round(200 * MS * k + 7 * MS * (k % 3)) for k in range(SETTLED_FRAMES)]
    assert [clock.on_arrival(t_ns, k).t_ns for k, t_ns in enumerate(t)] == t
    assert clock.on_arrival(t[-1] + 200 * MS, SETTLED_FRAMES).sigma_s > 0


def test_frames_that_never_came_are_counted() -> None:
    clock = FrameClock()
    arrived(clock, 100.0, 60, 5.0)
    errors = arrived(clock, 100.0, 40, 5.0, first=60, skip=3)
    assert np.abs(errors).max() < 6


def test_another_phase_begins_anew() -> None:
    clock = FrameClock()
    arrived(clock, 100.0, 60, 20.0)
    rng = Random(3)
    moved = []
    for k in range(60, 180):
        taken = 1150 + 100.0 * k + 45
        moved.append(clock.on_arrival(round((taken + rng.uniform(-20, 20)) * MS), k).t_ns / MS - taken)
    assert np.abs(moved[-40:]).mean() < 10


def test_another_rate_begins_anew() -> None:
    clock = FrameClock()
    arrived(clock, 50.0, 60, 3.0)
    last = 1150 + 50.0 * 59
    given = [clock.on_arrival(round((last + 70.0 * k) * MS), 59 + k).t_ns / MS - last - 70.0 * k for k in range(1, 81)]
    assert np.abs(given[-20:]).max() < 2


def test_a_gap_or_a_camera_that_counts_anew_begins_anew() -> None:
    for t_ns, number in ((60_000 * MS, 61), (7200 * MS, 0)):
        clock = FrameClock()
        arrived(clock, 100.0, 60, 20.0)
        assert clock.on_arrival(t_ns, number).t_ns == t_ns


def test_a_frame_that_was_overtaken_has_its_place() -> None:
    clock = FrameClock()
    arrived(clock, 100.0, 60, 0.0)
    arrived(clock, 100.0, 1, 0.0, first=61)
    late = clock.on_arrival(round((1150 + 6130) * MS), 60)
    assert late.t_ns / MS == pytest.approx(1150 + 6000, abs=1)
    assert abs(arrived(clock, 100.0, 5, 0.0, first=62)[-1]) < 1
