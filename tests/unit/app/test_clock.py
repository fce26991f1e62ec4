"""Clocks of the shell."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time

import pytest

from visloc_companion.app.clock import ManualClock, MonotonicClock
from visloc_companion.protocols import Clock


def test_both_are_clocks() -> None:
    assert isinstance(MonotonicClock(), Clock)
    assert isinstance(ManualClock(), Clock)


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.5, 3.3])
def test_monotonic_clock_is_the_machines_times_speed(speed: float) -> None:
    before = time.monotonic_ns()
    now = MonotonicClock(speed).now_ns()
    after = time.monotonic_ns()
    assert before * speed - 2e3 <= now <= after * speed + 2e3


def test_monotonic_clock_is_exact_for_a_machine_that_is_up_for_years(monkeypatch: pytest.MonkeyPatch) -> None:
    up_ns = 2**60 + 1
    monkeypatch.setattr(time, "monotonic_ns", lambda: up_ns)
    assert MonotonicClock(1.0).now_ns() == up_ns
    assert MonotonicClock(4.0).now_ns() == 4 * up_ns


def test_two_processes_agree() -> None:
    clock = MonotonicClock(8.0)
    code = (
        "from visloc_companion.app.clock import MonotonicClock; import sys; sys.stdout.write(str(MonotonicClock(8.0).now_ns()))"
    )
    before = clock.now_ns()
    other = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60).stdout)
    assert before <= other <= clock.now_ns()


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_not_positive_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed must be positive"):
        MonotonicClock(speed)


async def test_monotonic_sleep_ends_at_or_after_its_time() -> None:
    clock = MonotonicClock(10.0)
    due = clock.now_ns() + 100_000_000
    await clock.sleep_until(due)
    assert clock.now_ns() >= due
    await clock.sleep_until(due)  # the past: returns at once


async def test_manual_clock_wakes_sleepers_in_order_and_only_when_due() -> None:
    clock, woken = ManualClock(5), []

    async def sleeper(t_ns: int) -> None:
        await clock.sleep_until(t_ns)
        woken.append(t_ns)

    async with asyncio.TaskGroup() as group:
        for t_ns in (300, 100, 5, 200):
            group.create_task(sleeper(t_ns))
        await asyncio.sleep(0.001)
        assert woken == [5]
        clock.advance_to(250)
        await asyncio.sleep(0.001)
        assert woken == [5, 100, 200]
        clock.advance(1e-6)
    assert woken == [5, 100, 200, 300]


async def test_manual_clock_forgets_a_cancelled_sleeper() -> None:
    clock = ManualClock()
    task = asyncio.create_task(clock.sleep_until(10))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    clock.advance_to(20)
    assert clock.now_ns() == 20


def test_manual_clock_does_not_go_back() -> None:
    clock = ManualClock(10)
    with pytest.raises(ValueError, match="does not go back"):
        clock.advance_to(9)
