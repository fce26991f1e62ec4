"""The asyncio shell: every kind of connection, reconnecting, the tap, closing."""

import asyncio
import contextlib
import os
import socket
import tty
from collections.abc import Callable
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.adapters.mavlink.framing import Framer
from visloc_companion.adapters.mavlink.pymavlink_link import PymavlinkLink
from visloc_companion.adapters.mavlink.settings import SessionSettings
from visloc_companion.app.clock import ManualClock, MonotonicClock
from visloc_companion.errors import ConfigError
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.testing.fake_autopilot import FakeAutopilot
from visloc_companion.testing.loopback import HOST, tcp_autopilot, tcp_client_autopilot, udp_autopilot
from visloc_companion.types import EkfSource, Injection, SwitchSource

SPEED = 5.0
SETTINGS = SessionSettings(window_s=1.0, reconnect_s=0.2)


async def until(true: Callable[[], bool]) -> None:
    deadline_s = asyncio.get_running_loop().time() + 20.0
    while not true():
        assert asyncio.get_running_loop().time() < deadline_s
        await asyncio.sleep(0.005)


def test_a_wrong_url_is_an_error_at_once():
    with pytest.raises(ConfigError, match="udpin:HOST:PORT"):
        PymavlinkLink("udp://:14550", SETTINGS, ManualClock())


async def test_udpout_speaks_first():
    clock = MonotonicClock(SPEED)
    autopilot = FakeAutopilot()
    async with udp_autopilot(autopilot, clock, lambda: None) as port:
        link = PymavlinkLink(f"udpout:{HOST}:{port}", SETTINGS, clock)
        link.open()
        await until(lambda: link.session.link.up)
        await link.close()


async def test_udpout_waits_for_somebody_to_listen():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    link = PymavlinkLink(f"udpout:{HOST}:{port}", SETTINGS, MonotonicClock(SPEED))
    link.open()
    await asyncio.sleep(0.5)
    assert link.port
    await link.close()


async def test_tcpin_keeps_to_its_client_and_takes_another_once_that_is_silent():
    clock = MonotonicClock(SPEED)
    warnings: list[str] = []
    link = PymavlinkLink(f"tcpin:{HOST}:0", SETTINGS, clock, on_warning=warnings.append)
    link.open()
    await until(lambda: link.port is not None)
    assert link.port
    first, second, third = FakeAutopilot(), FakeAutopilot(), FakeAutopilot()
    async with tcp_client_autopilot(first, clock, link.port):
        await until(lambda: link.session.link.up)
        async with tcp_client_autopilot(second, clock, link.port):
            await until(lambda: bool(warnings))
            assert "is ignored" in warnings[0]
        first.behaviour.silent = True
        await until(lambda: not link.session.link.up)
        async with tcp_client_autopilot(third, clock, link.port):
            await until(lambda: len(third.heartbeats) > 0)
    assert second.heartbeats == []
    await link.close()


async def test_udpin_speaks_to_its_own_autopilot_only():
    """Two vehicles on one port, even with the same system id: an external position names no addressee."""
    clock = MonotonicClock(SPEED)
    warnings: list[str] = []
    ours, other, station = FakeAutopilot(), FakeAutopilot(), FakeAutopilot(system_id=255)
    station.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
    greeting = station.outgoing()
    link = PymavlinkLink(f"udpin:{HOST}:0", SETTINGS, clock, on_warning=warnings.append)
    link.open()
    await until(lambda: link.port is not None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind((HOST, 0))
        ground.setblocking(False)
        ground.sendto(greeting, (HOST, link.port))
        async with udp_autopilot(ours, clock, lambda: link.port):
            await until(lambda: link.session.origin is not None)
            async with udp_autopilot(other, clock, lambda: link.port):
                await until(lambda: bool(warnings))
                n_beats = len(ours.heartbeats)
                cov = ((1.0, 0.0), (0.0, 1.0))
                place = geo_from_ned((1.0, 2.0, -3.0), ours.origin)
                await link.send(Injection(clock.now_ns(), (1.0, 2.0, -3.0), place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0))
                await until(lambda: bool(ours.poses) and len(ours.heartbeats) > n_beats + 1)
        with pytest.raises(BlockingIOError):
            ground.recv(1000)
    assert (other.heartbeats, other.poses) == ([], [])
    assert len([text for text in warnings if "also speaks" in text]) == 1
    await link.close()


async def test_tcp_reconnects_after_the_other_side_was_away():
    clock = MonotonicClock(SPEED)
    warnings: list[str] = []
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    link = PymavlinkLink(f"tcp:{HOST}:{port}", SETTINGS, clock, on_warning=warnings.append)
    link.open()
    await until(lambda: any("cannot open" in text for text in warnings))
    loop = asyncio.get_running_loop()
    for _ in range(2):
        heard: list[bytes] = []
        autopilot = FakeAutopilot()
        autopilot.step(0)
        greeting = autopilot.outgoing()

        class Peer(asyncio.Protocol):
            def connection_made(self, transport, greeting=greeting):
                self.transport = transport
                transport.write(greeting)

            def data_received(self, data, heard=heard):
                heard.append(data)

        peer = Peer()
        server = await loop.create_server(lambda peer=peer: peer, HOST, port)
        await until(lambda heard=heard: bool(heard) and link.session.link.up)
        server.close()
        peer.transport.abort()
        await until(lambda: not link.session.link.up)
    assert link.reconnects >= 1
    await link.close()


async def test_a_half_open_tcp_connection_is_given_up():
    clock = MonotonicClock(20.0)
    autopilot = FakeAutopilot()
    autopilot.behaviour.silent = True
    warnings: list[str] = []
    async with tcp_autopilot(autopilot, clock) as port:
        link = PymavlinkLink(f"tcp:{HOST}:{port}", SETTINGS, clock, on_warning=warnings.append)
        link.open()
        await until(lambda: any("nothing arrives" in text for text in warnings))
        await link.close()


async def test_a_serial_line_works_and_comes_back_after_it_was_unplugged(tmp_path):
    clock = MonotonicClock(SPEED)
    device = tmp_path / "ttyFC"
    warnings: list[str] = []
    link = PymavlinkLink(f"serial:{device}:57600", SETTINGS, clock, on_warning=warnings.append)
    link.open()
    await until(lambda: any("cannot open" in text for text in warnings))
    for _ in range(2):
        controller, line = os.openpty()
        tty.setraw(line)
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(line))
        autopilot, framer = FakeAutopilot(), Framer()
        os.set_blocking(controller, False)
        got: list[object] = []

        def read(controller=controller, autopilot=autopilot, framer=framer, got=got) -> bool:
            autopilot.step(clock.now_ns())
            with contextlib.suppress(BlockingIOError):
                os.write(controller, autopilot.outgoing())
                got.extend(framer.feed(os.read(controller, 4096)))
            return bool(got) and link.session.link.up

        await until(read)
        device.unlink()
        os.close(line)
        os.close(controller)
        await until(lambda: not link.session.link.up)
    assert link.reconnects >= 1
    await link.close()


async def test_a_port_that_is_taken_is_tried_again():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HOST, 0))
        port = taken.getsockname()[1]
        warnings: list[str] = []
        link = PymavlinkLink(f"udpin:{HOST}:{port}", SETTINGS, MonotonicClock(SPEED), on_warning=warnings.append)
        link.open()
        await until(lambda: bool(warnings))
        assert f"udpin:{HOST}:{port}" in warnings[0]
        assert "another program has it" in warnings[0]
    await until(lambda: link.port == port)
    await link.close()


class Silent:
    """A connection on which nothing ever comes."""

    port, dropped = None, 0

    def write(self, packets: list[bytes]) -> None:
        """Nobody reads it."""

    def speak_to(self, source: object) -> None:
        """Nobody is there."""

    def close(self) -> None:
        """Nothing is open."""


async def opened_s(url: str, reconnect_s: float, refused: int, until_s: float) -> list[float]:
    """When a link opened its connection (which is refused so often), seconds."""
    clock, tries = ManualClock(), list[float]()

    async def opens(endpoint: object, listener: object) -> Silent:
        tries.append(clock.now_ns() * 1e-9)
        if len(tries) <= refused:
            raise ConnectionRefusedError("nobody listens")
        return Silent()

    link = PymavlinkLink(url, SessionSettings(reconnect_s=reconnect_s), clock, open_channel=opens)
    link.open()
    for _ in range(round(until_s / 0.05)):
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        clock.advance(0.05)
    await link.close()
    return tries


@pytest.mark.parametrize("url", ["tcp:10.0.0.2:5760", "serial:/dev/ttyAMA0:921600"])
async def test_a_stream_is_opened_anew_after_reconnect_s_and_three_seconds_of_silence(url: str):
    assert await opened_s(url, 2.0, 0, 16.0) == pytest.approx([0.0, 7.0, 14.0], abs=0.3)
    assert await opened_s(url, 0.5, 0, 9.0) == pytest.approx([0.0, 4.0, 8.0], abs=0.3)


async def test_tries_that_fail_come_twice_as_far_apart_up_to_ten_seconds():
    tries = await opened_s("tcp:10.0.0.2:5760", 2.0, 9, 36.0)
    assert tries == pytest.approx([0.0, 2.0, 6.0, 14.0, 24.0, 34.0], abs=0.4)


async def test_a_device_that_is_plugged_in_again_is_opened_at_once(tmp_path: Path):
    """What failed for long would be tried ten seconds later, all of them without a position."""
    device, clock, tries = tmp_path / "ttyFC", ManualClock(), list[float]()

    async def opens(endpoint: object, listener: object) -> Silent:
        tries.append(clock.now_ns() * 1e-9)
        if len(tries) < 7:
            raise FileNotFoundError(2, "No such file or directory")
        return Silent()

    link = PymavlinkLink(f"serial:{device}:57600", SessionSettings(reconnect_s=2.0), clock, open_channel=opens)
    link.open()
    for step in range(800):
        if step == 500:
            device.touch()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        clock.advance(0.05)
    await link.close()
    assert tries[:5] == pytest.approx([0.0, 2.0, 6.0, 14.0, 24.0], abs=0.4)
    assert tries[5:7] == pytest.approx([25.1, 27.1], abs=0.2), "at once, and soon again where it may not be used yet"


async def test_datagrams_have_no_connection_that_silence_could_end():
    assert await opened_s("udpin:0.0.0.0:14550", 2.0, 0, 30.0) == [0.0]


async def test_the_tap_sees_every_byte_of_both_directions():
    clock = MonotonicClock(SPEED)
    autopilot = FakeAutopilot()
    tapped: dict[bool, bytearray] = {False: bytearray(), True: bytearray()}
    stamps: list[int] = []

    def tap(data: bytes, t_ns: int, outgoing: bool) -> None:
        tapped[outgoing] += data
        stamps.append(t_ns)

    link = PymavlinkLink(f"udpin:{HOST}:0", SETTINGS, clock, on_raw=tap)
    link.open()
    async with udp_autopilot(autopilot, clock, lambda: link.port):
        await until(lambda: link.session.link.up and link.session.origin is not None)
        await link.close()
    incoming, outgoing = Framer(), Framer()
    kinds_in = {message.get_type() for message in incoming.feed(bytes(tapped[False]))}
    sent = outgoing.feed(bytes(tapped[True]))
    assert {"HEARTBEAT", "GPS_GLOBAL_ORIGIN"} <= kinds_in
    assert len(sent) >= autopilot.framer.counts.messages > 0
    assert all(message.get_msgbuf()[0] == 0xFD for message in sent)
    assert (incoming.counts.garbage_bytes, outgoing.counts.garbage_bytes) == (0, 0)
    assert stamps == sorted(stamps)


async def test_events_that_nobody_reads_are_bounded_and_counted():
    clock = MonotonicClock(SPEED)
    autopilot = FakeAutopilot()
    autopilot.rates_hz[30] = 100.0
    link = PymavlinkLink(f"udpin:{HOST}:0", SETTINGS, clock, capacity=20)
    events = link.events()
    async with udp_autopilot(autopilot, clock, lambda: link.port):
        await until(lambda: link.dropped_events > 50)
        await link.close()
    left = [event async for event in events]
    assert len(left) <= 20
    assert type(left[0]).__name__ == "LinkChanged"


async def test_close_ends_a_switch_that_waits():
    link = PymavlinkLink(f"udpin:{HOST}:0", SETTINGS, MonotonicClock())
    waiting = asyncio.create_task(link.switch(SwitchSource(EkfSource.VISION)))
    await asyncio.sleep(0)
    await link.close()
    assert await asyncio.wait_for(waiting, 5.0) is False


async def test_two_callers_of_one_switch_share_its_end():
    clock = MonotonicClock(SPEED)
    autopilot = FakeAutopilot()
    link = PymavlinkLink(f"udpin:{HOST}:0", SETTINGS, clock)
    link.open()
    async with udp_autopilot(autopilot, clock, lambda: link.port):
        await until(lambda: link.session.link.up)
        switch = SwitchSource(EkfSource.VISION)
        assert await asyncio.gather(link.switch(switch), link.switch(switch)) == [True, True]
        await link.close()
