"""A journal as a source of snapshots: what the daemon's status socket said in that flight, at some speed, again and again."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from visloc_companion.app.journal import Entry, read_journal
from visloc_companion.app.seen import Seen
from visloc_companion.app.serialise import to_json
from visloc_companion.errors import JournalError
from visloc_companion.types import Command, Event, Fix, FrameRef, Injection, LinkChanged, NoFix, Status, WorkerState
from visloc_companion.web.source import NoAnswer
from visloc_companion.web.view import Origin

REST_S = 5.0
"""How long the end is shown before it begins again."""
LONGEST_GAP_S = 5.0
"""Seconds of the flight in which nothing was written are passed over beyond this."""


class Flight:
    """What the daemon would have answered, built up from the journal's entries one by one."""

    def __init__(self) -> None:
        self._seen = Seen()
        self._status: Status | None = None
        self._now_ns = self._given = 0
        self._link_up = self._camera = False
        self._worker: dict[str, Any] | None = None

    def take(self, entry: Entry) -> None:
        """The next entry."""
        self._now_ns = max(self._now_ns, entry.now_ns)
        if entry.event is not None:
            self._seen.event(entry.event)
            self._event(entry.event)
        if entry.command is not None:
            self._seen.command(entry.now_ns, entry.command)
            self._command(entry.command)

    def _event(self, event: Event) -> None:
        match event:
            case LinkChanged():
                self._link_up = event.up
            case FrameRef():
                self._camera = True
            case Fix() | NoFix() if self._worker is None:
                self._worker = {"up": True, "restarts": 0, "given_up": False}
            case WorkerState():
                self._worker = {"up": event.up, "restarts": event.restarts, "given_up": False}

    def _command(self, command: Command) -> None:
        if isinstance(command, Status):
            self._status = command
        elif isinstance(command, Injection):
            self._given += 1

    def snapshot(self) -> dict[str, Any]:
        """In the shape of `Daemon.snapshot`, of what a journal holds."""
        return {
            "schema": 1,
            "t_ns": self._now_ns,
            "status": None if self._status is None else json.loads(to_json(self._status)),
            "link_up": self._link_up,
            "worker": self._worker,
            "journal": {"dropped": 0, "problem": ""},
            "injections": {"given": self._given, "sent": None, "dropped": None},
            "late": [],
            "camera": self._camera,
            **self._seen.snapshot(self._now_ns),
        }


class Recording:
    """source.Source of a journal."""

    def __init__(self, path: Path, speed: float, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Raises JournalError where the file is no journal, or holds no Status."""
        self.origin = Origin(path.name, speed)
        self._path, self._speed, self._clock_s = path, speed, clock_s
        if not any(isinstance(entry.command, Status) for entry in self._entries()):
            raise JournalError("holds no Status of a navigator", where=str(path), remedy="name a journal of a daemon's flight")
        self._begin()

    async def ask(self) -> dict[str, Any]:
        """What the daemon said at this moment of the flight. Raises NoAnswer where the file can no longer be read."""
        try:
            return await asyncio.to_thread(self._advanced)
        except JournalError as why:
            self._begin()
            raise NoAnswer(f"The recording cannot be read: {why}") from why

    def _entries(self) -> Iterator[Entry]:
        return read_journal(self._path, shell=True)

    def _begin(self) -> None:
        self._flight, self._left = Flight(), self._entries()
        self._next: Entry | None = None
        self._at_ns: int | None = None
        self._asked_s = self._clock_s()
        self._ended_s: float | None = None

    def _advanced(self) -> dict[str, Any]:
        now_s = self._clock_s()
        if self._ended_s is not None and now_s - self._ended_s > REST_S:
            self._begin()
        passed_ns = round(min(now_s - self._asked_s, 1.0) * self._speed * 1e9)  # what cannot keep pace is played slower
        self._asked_s = now_s
        if self._at_ns is None:
            self._next = next(self._left, None)
            self._at_ns = 0 if self._next is None else self._next.now_ns
        self._at_ns += passed_ns
        while self._next is not None and self._next.now_ns <= self._at_ns:
            self._flight.take(self._next)
            self._next = next(self._left, None)
        if self._next is None and self._ended_s is None:
            self._ended_s = now_s
        elif self._next is not None and self._next.now_ns - self._at_ns > LONGEST_GAP_S * 1e9:
            self._at_ns = self._next.now_ns
        return self._flight.snapshot()
