"""A clock that follows a simulator's own time, however fast or slow that runs."""

from __future__ import annotations

import asyncio

_NS_PER_S = 1_000_000_000
EPOCH_NS = 1_000 * _NS_PER_S
"""The clock's reading when the autopilot boots: not its boot clock, so that the conversion of clocks is exercised."""
_NAP_S = 0.002


class SlavedClock:
    """protocols.Clock that shows the latest time in the autopilot's messages, and never goes back.

    It does not run on between them: then it would now and again be ahead of the simulator, and what is sent would carry a
    time that has not come.
    """

    def __init__(self) -> None:
        self._now_ns = EPOCH_NS

    def hear(self, t_boot_ns: int) -> None:
        """A message carries this time of the autopilot's boot clock."""
        self._now_ns = max(self._now_ns, EPOCH_NS + t_boot_ns)

    def now_ns(self) -> int:
        """Simulated monotonic time, ns."""
        return self._now_ns

    async def sleep_until(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; yields to the loop at least once."""
        await asyncio.sleep(0)
        while self._now_ns < t_ns:  # noqa: ASYNC110 - thousands sleep at once nowhere here, and a nap is short
            await asyncio.sleep(_NAP_S)
