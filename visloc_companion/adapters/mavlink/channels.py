"""Bytes over UDP and TCP on the running asyncio loop (serial_channel.py: the same over a serial line).

A channel hands arriving bytes to `on_data` and calls `on_lost` once when the other side is gone. Writing never waits: what
does not fit is dropped and counted, because an old position is worth less than a new one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Protocol

from visloc_companion.adapters.mavlink.endpoint import Endpoint, EndpointKind

Address = tuple[Any, ...]
MAX_UNSENT_BYTES = 32_768
_MAX_STRANGERS = 16
_CONNECT_TIMEOUT_S = 3.0


@dataclass(frozen=True, slots=True)
class Listener:
    """Who is told of what arrives (with the sender's address, None on a serial line) and of the end.

    `has_autopilot` tells whether the autopilot is being heard; `on_stranger` is told of a sender that is turned away for it.
    """

    on_data: Callable[[bytes, Address | None], None]
    on_lost: Callable[[str], None]
    has_autopilot: Callable[[], bool]
    on_stranger: Callable[[str], None]


class Channel(Protocol):
    """An open connection."""

    @property
    def port(self) -> int | None:
        """The local port (of use where 0 let the system choose), None on a serial line."""

    @property
    def dropped(self) -> int:
        """Packets that were not sent because nobody takes them."""

    def write(self, packets: list[bytes]) -> None:
        """Send packets, each whole."""

    def speak_to(self, source: Address | None) -> None:
        """The autopilot was heard from this address."""

    def close(self) -> None:
        """Release the socket or port; `on_lost` is not called any more."""


OpenChannel = Callable[[Endpoint, Listener], Awaitable[Channel]]
"""Opens a connection. Raises OSError."""


class UdpChannel(asyncio.DatagramProtocol):
    """One datagram a packet. A listening one speaks only to the address that its autopilot is heard from, and while it is heard
    takes nothing from other addresses: external positions name no addressee, so a second vehicle would believe them too."""

    def __init__(self, listener: Listener, connected: bool) -> None:
        self.dropped = 0
        self.port: int | None = None
        self._listener = listener
        self._connected = connected
        self._peer: Address | None = None
        self._strangers: set[Address] = set()
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = transport
        self.port = transport.get_extra_info("sockname")[1]

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Called by asyncio."""
        if self._connected or addr == self._peer or self._peer is None or not self._listener.has_autopilot():
            self._listener.on_data(data, addr)
        elif addr not in self._strangers and len(self._strangers) < _MAX_STRANGERS:
            self._strangers.add(addr)
            self._listener.on_stranger(f"{addr[0]}:{addr[1]}")

    def speak_to(self, source: Address | None) -> None:
        """The autopilot was heard from this address."""
        self._peer = source

    def error_received(self, exc: Exception) -> None:
        """Called by asyncio: nobody listens at the far port yet, or no route. Datagrams are simply sent again."""
        self.dropped += 1

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        self._listener.on_lost("the socket was closed" if exc is None else str(exc))

    def write(self, packets: list[bytes]) -> None:
        """Send each packet in its own datagram."""
        transport = self._transport
        for packet in packets:
            if transport is None or transport.is_closing() or transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
                self.dropped += 1
            elif self._connected:
                transport.sendto(packet)
            elif self._peer is not None:
                transport.sendto(packet, self._peer)

    def close(self) -> None:
        """Release the socket."""
        self._listener = _DEAF
        if self._transport is not None:
            self._transport.abort()


class TcpChannel(asyncio.Protocol):
    """A byte stream. A listening one talks to one client; a new one is turned away while the autopilot is heard."""

    def __init__(self, listener: Listener, listening: bool) -> None:
        self.dropped = 0
        self.port: int | None = None
        self.server: asyncio.Server | None = None
        self._listener = listener
        self._listening = listening
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        assert isinstance(transport, asyncio.Transport)
        if self._transport is not None:
            if self._listener.has_autopilot():
                self._listener.on_stranger("{}:{}".format(*transport.get_extra_info("peername")[:2]))
                transport.abort()
                return
            self._transport.abort()
        self._transport = transport
        self.port = transport.get_extra_info("sockname")[1]

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        self._listener.on_data(data, None)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio. A listening channel waits for the next client."""
        if self._transport is not None and self._transport.is_closing():
            self._transport = None
        if not self._listening:
            self._listener.on_lost("the other side closed the connection" if exc is None else str(exc))

    def speak_to(self, source: Address | None) -> None:
        """There is one other side only."""

    def write(self, packets: list[bytes]) -> None:
        """Send packets, or drop them where the other side does not read."""
        transport = self._transport
        if transport is None or transport.is_closing() or transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            self.dropped += len(packets)
        else:
            transport.write(b"".join(packets))

    def close(self) -> None:
        """Release the sockets."""
        self._listener = _DEAF
        if self.server is not None:
            self.server.close()
        if self._transport is not None:
            self._transport.abort()


_DEAF = Listener(lambda _data, _source: None, lambda _why: None, lambda: False, lambda _who: None)


async def open_network_channel(endpoint: Endpoint, listener: Listener) -> Channel:
    """Open a UDP or TCP channel. Raises OSError (TimeoutError is one) where that fails."""
    loop = asyncio.get_running_loop()
    address = (endpoint.place, endpoint.number)
    if endpoint.kind in (EndpointKind.UDPIN, EndpointKind.UDPOUT):
        udp = UdpChannel(listener, connected=endpoint.kind is EndpointKind.UDPOUT)
        if endpoint.kind is EndpointKind.UDPIN:
            await loop.create_datagram_endpoint(lambda: udp, local_addr=address)
        else:
            await loop.create_datagram_endpoint(lambda: udp, remote_addr=address)
        return udp
    tcp = TcpChannel(listener, listening=endpoint.kind is EndpointKind.TCPIN)
    if endpoint.kind is EndpointKind.TCPIN:
        tcp.server = await loop.create_server(lambda: tcp, *address)
        tcp.port = tcp.server.sockets[0].getsockname()[1]
    else:
        async with asyncio.timeout(_CONNECT_TIMEOUT_S):
            await loop.create_connection(lambda: tcp, *address)
    return tcp
