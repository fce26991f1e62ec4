"""The output clock: ticks on a fixed time grid, so that lateness does not add up."""

from __future__ import annotations

from collections.abc import AsyncGenerator

from visloc_companion.protocols import Clock


async def time_grid(clock: Clock, rate_hz: float) -> AsyncGenerator[tuple[int, int], None]:
    """(now_ns, ticks slipped) at the instants of the grid `start + k / rate`; a late one skips what it missed.

    The grid is computed from k, so it does not drift with the rounding of the period.
    """
    start_ns, k = clock.now_ns(), 0
    while True:
        k += 1
        await clock.sleep_until(start_ns + round(k * 1e9 / rate_hz))
        now_ns = clock.now_ns()
        due = int((now_ns - start_ns) * rate_hz / 1e9)
        slipped = max(0, due - k)
        k += slipped
        yield now_ns, slipped
