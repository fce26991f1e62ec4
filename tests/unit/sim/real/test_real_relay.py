"""The relay between simulator and daemon."""

from __future__ import annotations

import asyncio
from typing import Any

from visloc_companion.adapters.mavlink.dialect import mav
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
