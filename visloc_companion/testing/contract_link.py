"""What every AutopilotLink must do, as a test class to inherit from.

    class TestMyLink(LinkContract):
        @asynccontextmanager
        async def bench(self):
            ...
            yield LinkBench(link, peer, clock)

pytest-asyncio (mode auto) runs the methods. The peer is the other side: `LinkPeer` says what the suite asks of it.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Protocol

from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.protocols import AutopilotLink, Clock
from visloc_companion.types import (
    Attitude,
    AutopilotKind,
    ComputerLoad,
    EkfSource,
    Event,
    GeoPoint,
    Injection,
    LinkChanged,
    Notice,
    OriginChanged,
    Report,
    RequestMessage,
    Severity,
    SourceSwitched,
    SwitchSource,
    Vec3,
)

ORIGIN = GeoPoint(47.3977, 8.5456, 488.0)
ATTITUDE_ID = 30
_PATIENCE_S = 20.0


class LinkPeer(Protocol):
    """The autopilot's side. It is heard from the start and has no origin."""

    def set_origin(self, origin: GeoPoint) -> None:
        """The estimator gets its origin."""

    def say_attitude(self) -> None:
        """Send one attitude."""

    def grant(self, *, streams: bool, switches: bool) -> None:
        """Whether requests are granted from now on."""

    def set_silent(self, silent: bool) -> None:
        """Stop sending, or begin again."""

    def source(self) -> EkfSource:
        """The position source in use."""

    def poses(self) -> list[tuple[Vec3, int]]:
        """Position (NED, m) and reset counter of each external position that arrived."""

    def texts(self) -> list[str]:
        """Texts that reached the operator, long ones in pieces."""

    def told(self) -> dict[str, float]:
        """The newest named values that a ground station would show, and `cores` where a computer's load was told."""


@dataclass(slots=True)
class LinkBench:
    """A link, its peer, the link's clock, and what the link said."""

    link: AutopilotLink
    peer: LinkPeer
    clock: Clock
    events: list[Event] = field(default_factory=list)
    ended: bool = False

    async def listen(self) -> None:
        """Collect events until the link ends."""
        async for event in self.link.events():
            self.events.append(event)
        self.ended = True

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until something is true; AssertionError with its name after 20 s."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + _PATIENCE_S
        while not true():
            assert loop.time() < deadline_s, f"still waiting: {what}"
            await asyncio.sleep(0.005)

    def links(self) -> list[bool]:
        """Up and down, in order, repeats left out."""
        ups = [event.up for event in self.events if isinstance(event, LinkChanged)]
        return [up for i, up in enumerate(ups) if i == 0 or ups[i - 1] != up]

    def count(self, kind: type[Event]) -> int:
        """How many events of a kind came."""
        return sum(isinstance(event, kind) for event in self.events)

    def injection(self, north_m: float = 12.0, reset_counter: int = 5) -> Injection:
        """A good injection of this moment."""
        cov = ((1.0, 0.0), (0.0, 1.0))
        p_ned_m = (north_m, -7.0, -40.0)
        place = geo_from_ned(p_ned_m, ORIGIN)
        return Injection(self.clock.now_ns(), p_ned_m, place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.05, reset_counter)


class LinkContract(ABC):
    """Inherit and give `bench`; every method that starts with `test_` is one demand."""

    @abstractmethod
    def bench(self) -> AbstractAsyncContextManager[LinkBench]:
        """A fresh link and peer; leaving the context closes the link and the peer."""

    async def _begin(self, bench: LinkBench) -> asyncio.Task[None]:
        listening = asyncio.create_task(bench.listen())
        await bench.until(lambda: bench.links() == [True], "the link comes up")
        return listening

    async def _end(self, bench: LinkBench, listening: asyncio.Task[None]) -> None:
        await bench.link.close()
        await asyncio.wait_for(listening, _PATIENCE_S)
        assert bench.ended

    async def test_is_seen_to_while_nothing_is_said(self) -> None:
        """`rounds` grows while the connection is served, also beside an autopilot that says nothing."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            bench.peer.set_silent(True)
            begun = bench.link.rounds
            await bench.until(lambda: bench.link.rounds > begun + 2, "three rounds")
            await self._end(bench, listening)

    async def test_comes_up_knowing_the_autopilot(self) -> None:
        """The first event is LinkChanged with kind and system id; `close` ends the events."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            first = bench.events[0]
            assert isinstance(first, LinkChanged)
            assert first.autopilot is not AutopilotKind.UNKNOWN
            assert first.system_id > 0
            await self._end(bench, listening)

    async def test_passes_events_stamped_with_arrival(self) -> None:
        """What the autopilot says comes out, stamped on our clock, never going back."""
        async with self.bench() as bench:
            before_ns = bench.clock.now_ns()
            listening = await self._begin(bench)
            bench.peer.say_attitude()
            await bench.until(lambda: bench.count(Attitude) > 0, "an attitude")
            stamps = [event.t_rx_ns for event in bench.events]
            assert stamps == sorted(stamps)
            assert before_ns <= stamps[0] <= stamps[-1] <= bench.clock.now_ns()
            await self._end(bench, listening)

    async def test_injects_only_with_an_origin(self) -> None:
        """Before the origin nothing is sent; after it position and reset counter arrive as they are."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            await bench.link.send(bench.injection(north_m=1.0))
            bench.peer.set_origin(ORIGIN)
            await bench.until(lambda: bench.count(OriginChanged) > 0, "the origin")
            origin = next(event.origin for event in bench.events if isinstance(event, OriginChanged))
            assert origin == ORIGIN
            await bench.link.send(bench.injection(north_m=12.0))
            await bench.until(lambda: bool(bench.peer.poses()), "a position")
            assert bench.peer.poses() == [((12.0, -7.0, -40.0), 5)]
            assert bench.link.withheld == ""
            assert (bench.link.n_sent, bench.link.left_out) == (1, 0), "what went out, not what was given"
            await self._end(bench, listening)

    async def test_request_tells_whether_it_arrives(self) -> None:
        """True for a stream that is granted, False for one that is not."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            assert await asyncio.wait_for(bench.link.request(RequestMessage(ATTITUDE_ID, 20.0)), _PATIENCE_S)
            bench.peer.grant(streams=False, switches=True)
            assert not await asyncio.wait_for(bench.link.request(RequestMessage(ATTITUDE_ID, 25.0)), _PATIENCE_S)
            await self._end(bench, listening)

    async def test_switches_and_says_so(self) -> None:
        """A confirmed switch gives True, an event, and the new source."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            assert await asyncio.wait_for(bench.link.switch(SwitchSource(EkfSource.VISION)), _PATIENCE_S)
            assert bench.peer.source() is EkfSource.VISION
            await bench.until(lambda: bench.count(SourceSwitched) == 1, "the event")
            assert await asyncio.wait_for(bench.link.switch(SwitchSource(EkfSource.GNSS)), _PATIENCE_S)
            assert bench.peer.source() is EkfSource.GNSS
            await self._end(bench, listening)

    async def test_a_refused_switch_is_false(self) -> None:
        """A refusal gives False and an event that says so; the source stays."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            bench.peer.grant(streams=True, switches=False)
            assert not await asyncio.wait_for(bench.link.switch(SwitchSource(EkfSource.VISION)), _PATIENCE_S)
            await bench.until(lambda: bench.count(SourceSwitched) == 1, "the event")
            assert not next(event for event in bench.events if isinstance(event, SourceSwitched)).accepted
            assert bench.peer.source() is EkfSource.GNSS
            await self._end(bench, listening)

    async def test_texts_reach_the_operator(self) -> None:
        """Only notices for the operator; a long one may come in pieces, and a repeat is not said again."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            text = "GNSS is not trusted: " + "x" * 50
            await bench.link.notify(Notice(Severity.INFO, "for the log only"))
            for _ in range(3):
                await bench.link.notify(Notice(Severity.WARNING, text, to_operator=True))
            await bench.link.notify(Notice(Severity.WARNING, "the end", to_operator=True))
            await bench.until(lambda: bench.peer.texts()[-1:] == ["the end"], "the texts")
            assert "".join(bench.peer.texts()) == text + "the end"
            await self._end(bench, listening)

    async def test_reports_reach_the_ground_station(self) -> None:
        """Named values and the computer's load."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            load = ComputerLoad(60.0, (0.5, 0.25, 0.0), 40.0, 2**30, 2**32, 2**33, 2**35)
            await bench.link.report(Report(bench.clock.now_ns(), (("VL_PL", 12.5), ("VL_MODE", 2))))
            await bench.link.report(Report(bench.clock.now_ns(), load=load, critical=True))
            await bench.until(lambda: "cores" in bench.peer.told(), "the load")
            assert bench.peer.told() == {"VL_PL": 12.5, "VL_MODE": 2, "cores": 3}
            await self._end(bench, listening)

    async def test_silence_and_return(self) -> None:
        """A silent autopilot takes the link down; when it speaks again the link comes up by itself."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            bench.peer.set_silent(True)
            await bench.until(lambda: bench.links() == [True, False], "the link goes down")
            bench.peer.set_silent(False)
            await bench.until(lambda: bench.links() == [True, False, True], "the link comes back")
            await self._end(bench, listening)

    async def test_nothing_after_close(self) -> None:
        """After `close` every call returns and sends nothing; closing again is harmless."""
        async with self.bench() as bench:
            listening = await self._begin(bench)
            bench.peer.set_origin(ORIGIN)
            await bench.until(lambda: bench.count(OriginChanged) > 0, "the origin")
            await self._end(bench, listening)
            await bench.link.send(bench.injection())
            await bench.link.notify(Notice(Severity.INFO, "late", to_operator=True))
            assert not await bench.link.request(RequestMessage(ATTITUDE_ID, 5.0))
            assert not await bench.link.switch(SwitchSource(EkfSource.VISION))
            await bench.link.close()
            await asyncio.sleep(0.05)
            assert (bench.peer.poses(), bench.peer.texts()) == ([], [])
