"""The clock that a simulator drives."""

from __future__ import annotations

import asyncio

from visloc_companion.sim.real.clock import EPOCH_NS, SlavedClock


def test_it_shows_the_latest_time_that_was_heard_and_never_goes_back() -> None:
    clock = SlavedClock()
    assert clock.now_ns() == EPOCH_NS
    clock.hear(10_000_000_000)
    clock.hear(9_000_000_000)
    assert clock.now_ns() == EPOCH_NS + 10_000_000_000


async def test_sleeping_ends_when_the_simulator_says_so_and_not_before() -> None:
    clock = SlavedClock()
    sleeping = asyncio.create_task(clock.sleep_until(EPOCH_NS + 2_500_000_000))
    clock.hear(2_499_000_000)
    await asyncio.sleep(0.01)
    assert not sleeping.done()
    clock.hear(2_500_000_000)
    await sleeping
