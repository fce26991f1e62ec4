"""Bounded queues between tasks of one event loop. A full one gives way by rule and counts it; it never blocks the sender."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A bounded first-in-first-out queue.

    When it is full, `newest_wins` decides who gives way: the oldest entry (for what ages, as positions do) or the new one
    (for what must not be reordered or lost once accepted, as requests). `taken`, `dropped` and `peak` are metrics.
    """

    def __init__(self, capacity: int, *, newest_wins: bool) -> None:
        if capacity < 1:
            raise ValueError(f"capacity must be at least 1, not {capacity}")
        self.capacity, self.newest_wins = capacity, newest_wins
        self.taken = self.dropped = self.peak = 0
        self._entries: deque[T] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._entries)

    def put(self, entry: T) -> bool:
        """Take an entry; False when it, or an older one in its stead, was dropped."""
        full = len(self._entries) >= self.capacity
        if full:
            self.dropped += 1
            if not self.newest_wins:
                return False
            self._entries.popleft()
        self._entries.append(entry)
        self.taken += 1
        self.peak = max(self.peak, len(self._entries))
        self._filled.set()
        return not full

    async def get(self) -> T:
        """The oldest entry; waits for one."""
        while not self._entries:
            self._filled.clear()
            await self._filled.wait()
        return self._entries.popleft()

    def clear(self) -> int:
        """Forget what waits; how many that were."""
        n = len(self._entries)
        self._entries.clear()
        return n
