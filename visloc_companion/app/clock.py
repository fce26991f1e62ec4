"""Clocks of the shell (protocols.Clock): the machine's monotonic clock, if wished sped up, and one that a test moves."""

from __future__ import annotations

import asyncio
import heapq
import time

_NS_PER_S = 1_000_000_000


class MonotonicClock:
    """The machine's CLOCK_MONOTONIC times `speed`.

    The epoch is the machine's, so two processes on one machine with the same speed agree on every instant. The product is
    computed in integers, so it is exact and never runs backwards however long the machine is up. Raises ValueError for a
    speed that is not positive.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be positive, not {speed}")
        self.speed = speed
        self._numerator, self._denominator = float(speed).as_integer_ratio()

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        return time.monotonic_ns() * self._numerator // self._denominator

    async def sleep_until(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; yields to the loop at least once."""
        await asyncio.sleep(0)
        while (left_ns := t_ns - self.now_ns()) > 0:  # noqa: ASYNC110 - a timer may fire early; there is no event to wait for
            await asyncio.sleep(left_ns / (self.speed * _NS_PER_S))


class ManualClock:
    """A clock that stands still until it is moved (simulation in one process, tests)."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._count = 0

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        return self._now_ns

    def advance(self, dt_s: float) -> None:
        """Move on by seconds and wake whoever is due."""
        self.advance_to(self._now_ns + round(dt_s * _NS_PER_S))

    def advance_to(self, t_ns: int) -> None:
        """Move to a time and wake whoever is due, earliest first. Raises ValueError for a step backwards."""
        if t_ns < self._now_ns:
            raise ValueError(f"a monotonic clock does not go back from {self._now_ns} to {t_ns} ns")
        self._now_ns = t_ns
        while self._sleepers and self._sleepers[0][0] <= t_ns:
            sleeper = heapq.heappop(self._sleepers)[2]
            if not sleeper.done():
                sleeper.set_result(None)

    async def sleep_until(self, t_ns: int) -> None:
        """Return when the clock was moved to `t_ns`; yields to the loop at least once."""
        if t_ns <= self._now_ns:
            await asyncio.sleep(0)
            return
        sleeper = asyncio.get_running_loop().create_future()
        self._count += 1
        heapq.heappush(self._sleepers, (t_ns, self._count, sleeper))
        await sleeper
