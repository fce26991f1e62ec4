"""Asks the source at a steady rate, whatever the number of browsers, and hands each of them the newest view."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from visloc_companion.web.heard import Heard
from visloc_companion.web.history import History, Sample
from visloc_companion.web.source import NoAnswer, Source
from visloc_companion.web.view import view_of

RATE_HZ = 4.0
MAX_STREAMS = 16


class Feed:
    """The newest view, the history, and whoever waits for the next. Nothing is queued: who is slow misses some."""

    def __init__(
        self,
        source: Source,
        *,
        rate_hz: float = RATE_HZ,
        max_streams: int = MAX_STREAMS,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._interval_s, self._max_streams, self._clock_s = source, 1.0 / rate_hz, max_streams, clock_s
        self._heard = Heard()
        self._history = History()
        self._changed = asyncio.Event()
        self._message = b""
        self.streams = 0
        self.closed = False

    @property
    def recording(self) -> bool:
        """Whether a journal is played."""
        return self._source.origin.recording

    def view(self) -> dict[str, Any]:
        """What is known now."""
        return view_of(self._heard, self._source.origin, self._clock_s())

    async def run(self) -> None:
        """Ask until cancelled."""
        while True:
            begun_s = self._clock_s()
            await self.round()
            await asyncio.sleep(max(self._interval_s / 4, self._interval_s - (self._clock_s() - begun_s)))

    async def round(self) -> None:
        """Ask once, and wake whoever waits."""
        try:
            snapshot = await self._source.ask()
            self._heard = Heard(snapshot, self._clock_s())
        except NoAnswer as why:
            self._heard = Heard(self._heard.snapshot, self._heard.at_s, str(why))
        now_s = self._clock_s()
        view = view_of(self._heard, self._source.origin, now_s)
        sample = self._history.take(view)
        self._message = _event("view", {"view": view, "sample": sample, "began": self._history.began, "at_s": now_s})
        self._wake()

    def history_message(self) -> bytes:
        """What a browser is given first: all that is kept, as an event of the stream."""
        samples: list[Sample | None] = self._history.samples()
        return _event("history", {"samples": samples, "began": self._history.began, "at_s": self._clock_s()})

    async def next_message(self) -> bytes | None:
        """Wait for the next view, as an event of the stream; None when the server ends."""
        if not self.closed:
            await self._changed.wait()
        return None if self.closed else self._message

    @contextmanager
    def stream(self) -> Iterator[bool]:
        """Count a stream in; False where there are as many as may be."""
        if self.streams >= self._max_streams:
            yield False
            return
        self.streams += 1
        try:
            yield True
        finally:
            self.streams -= 1

    def close(self) -> None:
        """Let every stream end."""
        self.closed = True
        self._wake()

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()


def _event(name: str, data: dict[str, Any]) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data, allow_nan=False, separators=(',', ':'))}\n\n".encode()
