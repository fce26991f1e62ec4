"""The bounded queue between the link and whoever reads its events."""

from __future__ import annotations

import asyncio
from collections import deque

from visloc_companion.types import Event, LinkChanged, OriginChanged, SourceSwitched

_KEPT = (LinkChanged, OriginChanged, SourceSwitched)


class EventQueue:
    """First in, first out. When it is full the oldest measurement gives way (`dropped` counts); changes of state are kept."""

    def __init__(self, capacity: int) -> None:
        self.dropped = 0
        self._capacity = capacity
        self._events: deque[Event] = deque()
        self._changed = asyncio.Event()
        self._closed = False
        self._failure: BaseException | None = None

    def __len__(self) -> int:
        return len(self._events)

    def put(self, event: Event) -> None:
        """Take an event."""
        self._events.append(event)
        if len(self._events) > self._capacity:
            oldest = next((i for i, old in enumerate(self._events) if not isinstance(old, _KEPT)), 0)
            del self._events[oldest]
            self.dropped += 1
        self._changed.set()

    def close(self, failure: BaseException | None = None) -> None:
        """No more events; who reads gets what is left, then the end (or the failure)."""
        self._closed, self._failure = True, failure
        self._changed.set()

    def __aiter__(self) -> EventQueue:
        return self

    async def __anext__(self) -> Event:
        while not self._events:
            if self._failure is not None:
                raise self._failure
            if self._closed:
                raise StopAsyncIteration
            self._changed.clear()
            await self._changed.wait()
        return self._events.popleft()
