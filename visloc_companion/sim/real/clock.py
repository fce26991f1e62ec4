"""A clock that follows a simulator's own time, however fast or slow that runs."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

_NS_PER_S = 1_000_000_000
EPOCH_NS = 1_000 * _NS_PER_S
"""The clock's reading when the autopilot boots: not its boot clock, so that the conversion of clocks is exercised."""
MAX_AHEAD_NS = 40_000_000
_NAP_S = 0.002


class SlavedClock:
    """protocols.Clock driven by the times in the autopilot's messages.

    Between two of them it runs on at the `speed` that is expected, at most `MAX_AHEAD_NS` beyond the last; so a simulator that
    stalls stalls whoever lives by this clock. It never goes back.
    """

    def __init__(self, speed: float = 1.0, wall_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._speed, self._wall_ns = speed, wall_ns
        self._heard_ns, self._heard_wall_ns = EPOCH_NS, wall_ns()
        self._now_ns = EPOCH_NS

    def hear(self, t_boot_ns: int) -> None:
        """A message carries this time of the autopilot's boot clock."""
        t_ns = EPOCH_NS + t_boot_ns
        if t_ns > self._heard_ns:
            self._heard_ns, self._heard_wall_ns = t_ns, self._wall_ns()

    def now_ns(self) -> int:
        """Simulated monotonic time, ns."""
        ahead_ns = min(MAX_AHEAD_NS, round((self._wall_ns() - self._heard_wall_ns) * self._speed))
        self._now_ns = max(self._now_ns, self._heard_ns + ahead_ns)
        return self._now_ns

    async def sleep_until(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; yields to the loop at least once."""
        await asyncio.sleep(0)
        while (left_ns := t_ns - self.now_ns()) > 0:  # noqa: ASYNC110 - only messages move this clock; there is nothing to await
            await asyncio.sleep(max(_NAP_S, min(0.05, 0.5 * left_ns / (self._speed * _NS_PER_S))))
