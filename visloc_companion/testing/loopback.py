"""A fake autopilot behind a real socket of this machine, for tests of links over UDP and TCP. Ports are the system's choice."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from visloc_companion.protocols import Clock
from visloc_companion.testing.fake_autopilot import FakeAutopilot

_STEP_NS = 10_000_000
HOST = "127.0.0.1"


class _UdpPeer(asyncio.DatagramProtocol):
    def __init__(self, autopilot: FakeAutopilot, target: Callable[[], int | None]) -> None:
        self._autopilot = autopilot
        self._target = target
        self._transport: Any = None
        self._from: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._from = addr
        self._autopilot.receive(data)
        self.write(self._autopilot.outgoing())

    def error_received(self, exc: Exception) -> None:
        """Nobody listens yet."""

    def write(self, data: bytes) -> None:
        port = self._target()
        target = (HOST, port) if port else self._from
        if data and target is not None and not self._transport.is_closing():
            self._transport.sendto(data, target)


class _TcpPeer(asyncio.Protocol):
    def __init__(self, autopilot: FakeAutopilot) -> None:
        self._autopilot = autopilot
        self.transports: list[Any] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transports = [transport]

    def data_received(self, data: bytes) -> None:
        self._autopilot.receive(data)
        self.write(self._autopilot.outgoing())

    def write(self, data: bytes) -> None:
        for transport in self.transports:
            if data and not transport.is_closing():
                transport.write(data)


async def _pump(autopilot: FakeAutopilot, clock: Clock, write: Callable[[bytes], None]) -> None:
    start_ns = clock.now_ns()
    while True:
        now_ns = clock.now_ns()
        autopilot.step(now_ns - start_ns)
        write(autopilot.outgoing())
        await clock.sleep_until(now_ns + _STEP_NS)


def free_port(kind: socket.SocketKind) -> int:
    """A port of this kind (SOCK_DGRAM, SOCK_STREAM) that nobody uses now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


@asynccontextmanager
async def udp_autopilot(autopilot: FakeAutopilot, clock: Clock, target: Callable[[], int | None]) -> AsyncIterator[int]:
    """Run the autopilot on UDP; gives its port. It sends to port `target()`, or back to whoever spoke where that is None."""
    loop = asyncio.get_running_loop()
    transport, peer = await loop.create_datagram_endpoint(lambda: _UdpPeer(autopilot, target), local_addr=(HOST, 0))
    pump = loop.create_task(_pump(autopilot, clock, peer.write))
    try:
        yield transport.get_extra_info("sockname")[1]
    finally:
        await _stop(pump, transport.abort)


@asynccontextmanager
async def tcp_autopilot(autopilot: FakeAutopilot, clock: Clock) -> AsyncIterator[int]:
    """Run the autopilot as a TCP server; gives its port."""
    loop = asyncio.get_running_loop()
    peer = _TcpPeer(autopilot)
    server = await loop.create_server(lambda: peer, HOST, 0)
    pump = loop.create_task(_pump(autopilot, clock, peer.write))
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        await _stop(pump, lambda: [transport.abort() for transport in peer.transports])


@asynccontextmanager
async def tcp_client_autopilot(autopilot: FakeAutopilot, clock: Clock, port: int) -> AsyncIterator[None]:
    """Run the autopilot as a TCP client of a listening link."""
    loop = asyncio.get_running_loop()
    transport, peer = await loop.create_connection(lambda: _TcpPeer(autopilot), HOST, port)
    pump = loop.create_task(_pump(autopilot, clock, peer.write))
    try:
        yield
    finally:
        await _stop(pump, transport.abort)


async def _stop(pump: asyncio.Task[None], abort: Callable[[], object]) -> None:
    pump.cancel()
    await asyncio.gather(pump, return_exceptions=True)
    abort()
    await asyncio.sleep(0)
