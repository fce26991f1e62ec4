"""Stands between the simulator and the daemon: what the autopilot says moves the clock before the daemon hears it.

Without it a message could reach the daemon before the clock has come to the message's own time, as no message can in flight;
the filters that look for the shortest delay (ours and ArduPilot's) would keep that for minutes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from visloc_companion.adapters.mavlink.dialect import Message
from visloc_companion.adapters.mavlink.framing import Framer

Address = tuple[Any, ...]


def whole(message: Message) -> bytes:
    """The message as it came."""
    return bytes(message.get_msgbuf())


class Relay:
    """UDP between `front_port`, where the simulator sends, and `back_port`, where the daemon listens; both on the loopback.

    `passed` says in which bytes a message reaches the daemon (empty: not at all).
    """

    def __init__(
        self, front_port: int, back_port: int, on_message: Callable[[Message], None], passed: Callable[[Message], bytes] = whole
    ) -> None:
        self._ports, self._on_message, self._passed = (front_port, back_port), on_message, passed
        self._framer = Framer()
        self._front: Any = None
        self._back: Any = None
        self._simulator: Address | None = None

    async def open(self) -> None:
        """Begin. Raises OSError for a port in use."""
        loop, (front, back) = asyncio.get_running_loop(), self._ports
        self._front, _ = await loop.create_datagram_endpoint(lambda: _Ear(self._from_simulator), ("127.0.0.1", front))
        self._back, _ = await loop.create_datagram_endpoint(lambda: _Ear(self._from_daemon), remote_addr=("127.0.0.1", back))

    def close(self) -> None:
        """Release the sockets."""
        for transport in (self._front, self._back):
            if transport is not None:
                transport.abort()

    def _from_simulator(self, data: bytes, source: Address) -> None:
        self._simulator = source
        messages = self._framer.feed(data)
        for message in messages:
            self._on_message(message)
        told = [(whole(message), self._passed(message)) for message in messages]
        if any(said != passed for said, passed in told):
            data = b"".join(passed for _, passed in told)
        if data:
            self._back.sendto(data)

    def _from_daemon(self, data: bytes, _source: Address) -> None:
        if self._simulator is not None:
            self._front.sendto(data, self._simulator)


class _Ear(asyncio.DatagramProtocol):
    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Called by asyncio."""
        self._take(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Called by asyncio while the daemon does not listen yet."""
