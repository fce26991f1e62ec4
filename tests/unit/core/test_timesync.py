from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.timesync import ClockOffset, ClockStep
from visloc_companion.types import TimesyncSample

MS = 1_000_000
S = 1_000_000_000
OFFSET = 7_123_456_789


def test_unknown_before_anything_arrived() -> None:
    clock = ClockOffset()
    assert clock.offset_ns() is None
    assert clock.shell_ns(5, fallback_ns=99) == 99
    assert clock.boot_ns(5) is None


def test_one_way_minimum_is_late_by_the_shortest_latency_only() -> None:
    rng = np.random.default_rng(1)
    clock = ClockOffset()
    for k in range(500):
        latency = 2 * MS + int(rng.exponential(15 * MS))
        assert clock.on_arrival(OFFSET + k * 20 * MS + latency, k * 20 * MS) is None
    offset = clock.offset_ns()
    assert offset is not None
    assert 2 * MS <= offset - OFFSET < 2.5 * MS
    assert clock.shell_ns(10 * S, 0) == 10 * S + offset
    assert clock.boot_ns(10 * S + offset) == 10 * S


def test_timesync_wins_with_its_shortest_round_trip() -> None:
    clock = ClockOffset()
    for k in range(100):
        clock.on_arrival(OFFSET + k * 100 * MS + 8 * MS, k * 100 * MS)
    for there, back in ((9, 1), (1, 1), (1, 20)):
        sent = OFFSET + 10 * S
        remote = 10 * S + there * MS
        assert clock.on_exchange(TimesyncSample(sent + (there + back) * MS, sent, remote)) is None
    assert clock.offset_ns() == OFFSET


@pytest.mark.parametrize("round_trip_ms", [-5, 60])
def test_long_or_impossible_round_trips_are_not_used(round_trip_ms: int) -> None:
    clock = ClockOffset()
    assert clock.on_exchange(TimesyncSample(S + round_trip_ms * MS, S, 0)) is None
    assert clock.offset_ns() is None


def test_drift_of_100_ppm_is_followed() -> None:
    clock = ClockOffset()
    rng = np.random.default_rng(2)
    for k in range(6000):
        boot = k * 20 * MS
        true_offset = OFFSET + boot // 10_000
        clock.on_arrival(boot + true_offset + int(rng.uniform(1, 5) * MS), boot)
    offset = clock.offset_ns()
    assert offset is not None
    assert abs(offset - true_offset) < 4 * MS  # a window of 20 s drifts by 2 ms


def test_after_a_long_silence_nothing_old_remains() -> None:
    clock = ClockOffset()
    clock.on_arrival(OFFSET, 0)
    clock.on_arrival(OFFSET + 30 * S + 100 * MS, 30 * S)
    assert clock.offset_ns() == OFFSET + 100 * MS


def test_a_reboot_is_a_step_at_once() -> None:
    clock = ClockOffset()
    clock.on_arrival(OFFSET + 100 * S, 100 * S)
    step = clock.on_arrival(OFFSET + 101 * S, 1 * S)
    assert step == ClockStep(100 * S, of_autopilot=True)
    assert clock.offset_ns() == OFFSET + 100 * S


def test_one_message_that_comes_again_late_is_no_step() -> None:
    clock = ClockOffset()
    clock.on_arrival(OFFSET + 100 * S, 100 * S)
    assert clock.on_arrival(OFFSET + 100 * S + MS, 98 * S) is None
    assert clock.on_arrival(OFFSET + 101 * S, 101 * S) is None
    assert clock.offset_ns() == OFFSET


def test_a_clock_set_forward_is_a_step_at_once() -> None:
    clock = ClockOffset()
    clock.on_arrival(OFFSET + S, S)
    assert clock.on_arrival(OFFSET + 2 * S, 9 * S) == ClockStep(-7 * S)
    assert clock.offset_ns() == OFFSET - 7 * S


def test_a_stalled_link_is_no_step_but_lasting_lateness_is() -> None:
    clock = ClockOffset()
    clock.on_arrival(OFFSET, 0)
    for k in range(1, 30):  # three seconds of lateness, then the link recovers
        assert clock.on_arrival(OFFSET + k * 100 * MS + 2 * S, k * 100 * MS) is None
    assert clock.on_arrival(OFFSET + 6 * S, 6 * S) is None
    steps = [clock.on_arrival(OFFSET + 7 * S + k * 100 * MS + S, 7 * S + k * 100 * MS) for k in range(60)]
    assert [s for s in steps if s is not None] == [ClockStep(S)]


def test_first_messages_that_lay_in_a_buffer_are_no_step() -> None:
    """A radio delivers the first messages 1.5 s late: better knowledge, not another clock."""
    clock = ClockOffset()
    clock.on_arrival(OFFSET + 1500 * MS, 0)
    assert clock.on_arrival(OFFSET + 1600 * MS, 800 * MS) is None
    assert clock.on_arrival(OFFSET + 1700 * MS, 1690 * MS) is None
    assert clock.offset_ns() == OFFSET + 10 * MS
    late = ClockOffset()
    late.on_arrival(OFFSET + 1500 * MS, 0)
    assert late.on_exchange(TimesyncSample(OFFSET + 2002 * MS, OFFSET + 2000 * MS, 2001 * MS)) is None
    assert late.offset_ns() == OFFSET


@pytest.mark.parametrize("jump_s", [-6, 1])
def test_timesync_finds_a_step_too(jump_s: int) -> None:
    clock = ClockOffset()
    clock.on_exchange(TimesyncSample(OFFSET + 2 * MS, OFFSET, MS))
    got = clock.on_exchange(TimesyncSample(OFFSET + S + 2 * MS, OFFSET + S, S - jump_s * S + MS))
    assert got == ClockStep(jump_s * S)
    assert clock.offset_ns() == OFFSET + jump_s * S
