"""One suite on the fake and on the real links over loopback UDP and TCP, plain and signed, against both kinds of autopilot."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from visloc_companion.adapters.mavlink.mavsdk_channel import MavsdkOpener
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.adapters.mavlink.signing import SigningSettings, stamp_at_zero
from visloc_companion.app.clock import MonotonicClock
from visloc_companion.protocols import AutopilotLink
from visloc_companion.testing.contract_link import LinkBench, LinkContract
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.testing.fake_link import FakeLink
from visloc_companion.testing.link_peers import FakePeer, WirePeer
from visloc_companion.testing.loopback import free_port, tcp_autopilot, udp_autopilot
from visloc_companion.testing.signing_peer import PymavlinkSigning
from visloc_companion.types import AutopilotKind

SPEED = 5.0
SETTINGS = SessionSettings(window_s=1.0)
KEY = bytes(range(32))


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


class TestMavsdkLinkOverUdp(LinkContract):
    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        pytest.importorskip("mavsdk", reason="MAVSDK is missing: pip install 'visloc-companion[mavsdk]'")
        clock = MonotonicClock(SPEED)
        autopilot = FakeAutopilot(kind=AutopilotKind.ARDUPILOT, origin=None)
        port = free_port(socket.SOCK_DGRAM)
        link = PymavlinkLink(f"udpin:127.0.0.1:{port}", SETTINGS, clock, open_channel=MavsdkOpener(0, 197))
        async with udp_autopilot(autopilot, clock, lambda: port):
            yield LinkBench(link, WirePeer(autopilot), clock)
            await link.close()


class TestMavsdkLinkOverTcp(LinkContract):
    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        pytest.importorskip("mavsdk", reason="MAVSDK is missing: pip install 'visloc-companion[mavsdk]'")
        clock = MonotonicClock(SPEED)
        autopilot = FakeAutopilot(kind=AutopilotKind.PX4, origin=None)
        async with tcp_autopilot(autopilot, clock) as port:
            link = PymavlinkLink(f"tcp:127.0.0.1:{port}", SETTINGS, clock, open_channel=MavsdkOpener(0, 197))
            yield LinkBench(link, WirePeer(autopilot), clock)
            await link.close()


class TestPymavlinkLinkSigned(LinkContract):
    """The autopilot has no time of its own: it is believed once it has heard ours."""

    @asynccontextmanager
    async def bench(self) -> AsyncIterator[LinkBench]:
        clock = MonotonicClock(SPEED)
        autopilot = FakeAutopilot(origin=None, signing=PymavlinkSigning(KEY, stamp=0, link_id=1))
        signing = SigningSettings(KEY, stamp_at_zero=stamp_at_zero(time.time_ns(), clock.now_ns()))
        link = PymavlinkLink("udpin:127.0.0.1:0", replace(SETTINGS, signing=signing), clock)
        async with udp_autopilot(autopilot, clock, lambda: link.port):
            yield LinkBench(link, WirePeer(autopilot), clock)
            await link.close()
        assert autopilot.signing is not None
        assert autopilot.signing.refused == 0


async def test_a_stranger_without_the_key_changes_nothing() -> None:
    """It speaks first, as the autopilot's system and as another, and cannot take the link, its address or its state."""
    clock = MonotonicClock(SPEED)
    signing = SigningSettings(KEY, stamp_at_zero=stamp_at_zero(time.time_ns(), clock.now_ns()))
    link = PymavlinkLink("udpin:127.0.0.1:0", replace(SETTINGS, signing=signing), clock)
    autopilot = FakeAutopilot(signing=PymavlinkSigning(KEY, stamp=0))
    plain, forger = FakeAutopilot(), FakeAutopilot(system_id=7, signing=PymavlinkSigning(bytes(range(1, 33)), stamp=2**47))
    bench = LinkBench(link, WirePeer(autopilot), clock)
    listening = asyncio.create_task(bench.listen())
    await bench.until(lambda: link.port is not None, "the port")
    async with udp_autopilot(plain, clock, lambda: link.port), udp_autopilot(forger, clock, lambda: link.port):
        await bench.until(lambda: sum(link.session.unbelieved.values()) >= 4, "what the strangers say")
        assert bench.events == []
        async with udp_autopilot(autopilot, clock, lambda: link.port):
            await bench.until(lambda: bool(link.session.link.version), "the autopilot's version")
    assert link.session.link.system_id == 1
    await link.close()
    await listening
    assert autopilot.heartbeats
    assert (plain.heartbeats, forger.heartbeats) == ([], []), "nothing was ever sent to them"
