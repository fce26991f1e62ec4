"""Ticks lie on the grid."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from visloc_companion.app.clock import ManualClock
from visloc_companion.app.ticker import time_grid

MS = 1_000_000


class LateClock(ManualClock):
    """Every sleep ends late by the next of `late_ns`."""

    def __init__(self, late_ns: list[int]) -> None:
        super().__init__(1000)
        self.late_ns = late_ns

    async def sleep_until(self, t_ns: int) -> None:
        await asyncio.sleep(0)
        self._now_ns = max(self._now_ns, t_ns) + (self.late_ns.pop(0) if self.late_ns else 0)


async def ticks(clock: ManualClock, rate_hz: float, n: int) -> list[tuple[int, int]]:
    found = []
    async with contextlib.aclosing(time_grid(clock, rate_hz)) as grid:
        async for tick in grid:
            found.append(tick)
            if len(found) == n:
                return found
    return found


async def test_ticks_come_at_the_rate_and_do_not_drift() -> None:
    found = await ticks(LateClock([]), 30.0, 30_000)
    assert found[0] == (1000 + round(1e9 / 30), 0)
    assert found[-1][0] == 1000 + 1_000_000_000_000  # 1000 s, to the ns
    assert all(slipped == 0 for _, slipped in found)


async def test_lateness_does_not_add_up() -> None:
    found = await ticks(LateClock([30 * MS] * 5), 10.0, 6)
    assert [t for t, _ in found] == [1000 + k * 100 * MS + (30 * MS if k < 6 else 0) for k in range(1, 7)]


async def test_missed_ticks_are_counted_and_not_made_up_for() -> None:
    found = await ticks(LateClock([0, 250 * MS]), 10.0, 4)
    assert found == [
        (1000 + 100 * MS, 0),
        (1000 + 450 * MS, 2),
        (1000 + 500 * MS, 0),
        (1000 + 600 * MS, 0),
    ]


@pytest.mark.parametrize("late_ms", [99, 100, 101])
async def test_a_slip_is_a_whole_period(late_ms: int) -> None:
    found = await ticks(LateClock([late_ms * MS]), 10.0, 1)
    assert found[0][1] == (1 if late_ms >= 100 else 0)
