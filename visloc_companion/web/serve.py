"""Serves the dashboard until it is told to stop."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from visloc_companion.errors import ConfigError
from visloc_companion.web.feed import Feed

CONNECTIONS = 64
UNREAD_MS = 15_000
"""The system drops a connection whose other end has taken nothing for so long."""
REQUEST_S = 10.0
"""A connection that has asked for nothing in so long is closed: browsers open some ahead, and those of one that went out of the
radio's reach would stay for ever, and take the place of others."""
SEND_BUFFER_BYTES = 128 * 1024
"""Of each connection: what a client that stopped reading can hold."""


class _Connection(H11Protocol):
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(REQUEST_S, self._close_unused)

    def _close_unused(self) -> None:
        request: object = self.cycle  # typed as if there always were one
        if request is None:
            self.transport.close()


class _Server(uvicorn.Server):
    """Without signal handlers of its own: whoever calls `serve` has them, and the streams end first."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def listening(host: str, port: int) -> socket.socket:
    """A socket bound to an address. Raises ConfigError where that cannot be done."""
    listener: socket.socket | None = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNREAD_MS)
        listener.bind(address)
        listener.listen(CONNECTIONS)
    except (OSError, UnicodeError) as why:  # the latter of names that no name server could be asked for
        if listener is not None:
            listener.close()
        remedy = "name another --port, or an address of this computer for --host"
        said = why.strerror if isinstance(why, OSError) and why.strerror else str(why)
        raise ConfigError(f"cannot be listened on: {said}", where=f"{host} port {port}", remedy=remedy) from why
    return listener


async def serve(
    feed: Feed,
    app: ASGIApp,
    listener: socket.socket,
    stop: asyncio.Event,
) -> None:
    """Ask and answer until `stop` is set. Raises what the source raises besides NoAnswer."""
    settings = uvicorn.Config(
        app,
        http=_Connection,
        ws="none",
        loop="asyncio",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS,
        timeout_graceful_shutdown=2,
    )
    server = _Server(settings)
    asking = asyncio.create_task(feed.run())
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    stopping = asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({asking, serving, stopping}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        feed.close()
        server.should_exit = True
        for task in (asking, stopping):
            task.cancel()
        await asyncio.gather(asking, stopping, return_exceptions=True)
        await serving
    if asking.done() and not asking.cancelled() and (fault := asking.exception()) is not None:
        raise fault
