"""The relay between simulator and daemon."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.adapters.mavlink.dialect import mav
from visloc_companion.core.velocity.pitot import true_airspeed_mps
from visloc_companion.sim.real.px4 import Px4
from visloc_companion.sim.real.relay import Relay


class Peer(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.heard: asyncio.Queue[bytes] = asyncio.Queue()
        self.transport: Any = None
        self.source: Any = None

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.source = addr
        self.heard.put_nowait(data)


async def test_bytes_go_both_ways_and_the_clock_is_told_first(unused_udp_port_factory: Any) -> None:
    front, back = unused_udp_port_factory(), unused_udp_port_factory()
    loop, order = asyncio.get_running_loop(), list[str]()
    _, daemon = await loop.create_datagram_endpoint(Peer, ("127.0.0.1", back))
    relay = Relay(front, back, lambda message: order.append(message.get_type()))
    await relay.open()
    _, simulator = await loop.create_datagram_endpoint(Peer, remote_addr=("127.0.0.1", front))
    packet = mav.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0).pack(mav.MAVLink(None, 1, 1))
    simulator.transport.sendto(packet)
    assert await asyncio.wait_for(daemon.heard.get(), 5.0) == packet
    assert order == ["ATTITUDE"]
    daemon.transport.sendto(b"answer", daemon.source)
    assert await asyncio.wait_for(simulator.heard.get(), 5.0) == b"answer"
    relay.close()
    simulator.transport.close()
    daemon.transport.close()
    await asyncio.sleep(0)


def sent(*messages: Any) -> list[Any]:
    """As they arrive."""
    link, parser = mav.MAVLink(None, 1, 1), mav.MAVLink(None)
    return [parsed for message in messages for parsed in parser.parse_buffer(message.pack(link))]


PRESSURE = mav.MAVLink_scaled_pressure_message(1000, 955.0, 0.0, 1183, 0)


def test_a_plane_says_the_dynamic_pressure_of_the_airspeed_that_it_goes_by() -> None:
    plane = Px4(True, Path())
    speed, pressure = sent(mav.MAVLink_vfr_hud_message(14.0, 15.0, 0, 0, 0.0, 0.0), PRESSURE)
    assert plane.passed(speed) == bytes(speed.get_msgbuf())
    [told] = mav.MAVLink(None).parse_buffer(plane.passed(pressure))
    assert (told.get_srcSystem(), told.get_srcComponent(), told.get_seq()) == (1, 1, pressure.get_seq())
    assert (told.time_boot_ms, told.press_abs, told.temperature) == (1000, 955.0, 1183)
    assert true_airspeed_mps(1013.25, told.press_diff) == pytest.approx(14.0, rel=1e-3)
    assert true_airspeed_mps(told.press_abs, told.press_diff) == pytest.approx(14.0 * (1.225 / 1.167) ** 0.5, rel=5e-3)


def test_without_an_airspeed_there_is_no_dynamic_pressure() -> None:
    plane = Px4(True, Path())
    for message in sent(
        mav.MAVLink_vfr_hud_message(14.0, 15.0, 0, 0, 0.0, 0.0), mav.MAVLink_vfr_hud_message(math.nan, 15.0, 0, 0, 0, 0)
    ):
        plane.passed(message)
    [told] = mav.MAVLink(None).parse_buffer(plane.passed(*sent(PRESSURE)))
    assert told.press_diff == 0.0


def test_a_quadrotor_has_no_tube_and_nobody_gets_its_false_calendar() -> None:
    copter = Px4(False, Path())
    speed, pressure, calendar = sent(
        mav.MAVLink_vfr_hud_message(14.0, 15.0, 0, 0, 0.0, 0.0), PRESSURE, mav.MAVLink_system_time_message(1, 1)
    )
    assert [copter.passed(message) for message in (speed, pressure)] == [
        bytes(message.get_msgbuf()) for message in (speed, pressure)
    ]
    assert copter.passed(calendar) == b""


async def test_a_message_is_passed_as_it_is_told_to_be(unused_udp_port_factory: Any) -> None:
    front, back = unused_udp_port_factory(), unused_udp_port_factory()
    loop = asyncio.get_running_loop()
    _, daemon = await loop.create_datagram_endpoint(Peer, ("127.0.0.1", back))
    relay = Relay(front, back, lambda _: None, lambda message: b"" if message.get_type() == "SYSTEM_TIME" else b"other")
    await relay.open()
    _, simulator = await loop.create_datagram_endpoint(Peer, remote_addr=("127.0.0.1", front))
    link = mav.MAVLink(None, 1, 1)
    for message in (mav.MAVLink_system_time_message(1, 1), PRESSURE):
        simulator.transport.sendto(message.pack(link))
    assert await asyncio.wait_for(daemon.heard.get(), 5.0) == b"other"
    relay.close()
    simulator.transport.close()
    daemon.transport.close()
    await asyncio.sleep(0)
