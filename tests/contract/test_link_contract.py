"""One suite on the fake and on the real link over loopback UDP and TCP, against both kinds of autopilot."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.protocols import AutopilotLink
from visloc_companion.testing.contract_link import LinkBench, LinkContract
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.testing.link_peers import FakePeer, WirePeer
from visloc_companion.testing.loopback import tcp_autopilot, udp_autopilot
from visloc_companion.types import AutopilotKind

SPEED = 5.0
SETTINGS = SessionSettings(window_s=1.0)


class TestFakeLink(LinkContract):
    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        clock = MonotonicClock()
        link = FakeLink(clock)
        assert isinstance(link, AutopilotLink)
        yield LinkBench(link, FakePeer(link), clock)
        await link.close()


class TestPymavlinkLinkOverUdp(LinkContract):
    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        clock = MonotonicClock(SPEED)
        autopilot = FakeAutopilot(kind=AutopilotKind.ARDUPILOT, origin=None)
        link = PymavlinkLink("udpin:127.0.0.1:0", SETTINGS, clock)
        assert isinstance(link, AutopilotLink)
        async with udp_autopilot(autopilot, clock, lambda: link.port):
            yield LinkBench(link, WirePeer(autopilot), clock)
            await link.close()


class TestPymavlinkLinkOverTcp(LinkContract):
    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        clock = MonotonicClock(SPEED)
        autopilot = FakeAutopilot(kind=AutopilotKind.PX4, origin=None)
        async with tcp_autopilot(autopilot, clock) as port:
            link = PymavlinkLink(f"tcp:127.0.0.1:{port}", SETTINGS, clock)
            yield LinkBench(link, WirePeer(autopilot), clock)
            await link.close()
