"""When a daemon judges for the first time what it has heard."""

from __future__ import annotations

import asyncio

import pytest

from tests.unit.app.daemon import HOME, FakeNotifier, constructors
from visloc_companion.app.clock import ManualClock
from visloc_companion.app.live import Daemon
from visloc_companion.app.parts import Parts
from visloc_companion.config import Config
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.types import LinkChanged, OriginChanged, Tick


async def test_what_was_heard_while_the_daemon_started_is_judged_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A start in flight is time without positions: the first Tick comes after what waits, and before the clock has gone on."""
    clock, stop, happened = ManualClock(5_000_000_000), asyncio.Event(), list[type]()
    link = FakeLink(clock, origin=HOME)
    parts = Parts(Config(), clock, link, heard=link.events())
    daemon = Daemon(parts, constructors(link, [], "prior_is_right"), FakeNotifier())
    monkeypatch.setattr(daemon.navigator, "on", lambda event, _: happened.append(type(event)) or [])
    running = asyncio.create_task(daemon.run(stop))
    for _ in range(20):
        await asyncio.sleep(0)
    assert happened == [LinkChanged, OriginChanged, Tick]
    stop.set()
    await running
