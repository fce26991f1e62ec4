"""The server with real sockets: streams that end with it, as many as may be, and clients that do not read."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from tests.unit.web.asking import Said
from tests.unit.web.snapshots import snapshot
from visloc_companion.errors import ConfigError
from visloc_companion.web import serve as serve_module
from visloc_companion.web import stream
from visloc_companion.web.feed import Feed
from visloc_companion.web.guard import own_names
from visloc_companion.web.serve import listening, serve
from visloc_companion.web.server import application

HEAD = b"GET %s HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@asynccontextmanager
async def running(feed: Feed) -> AsyncIterator[int]:
    stop = asyncio.Event()
    with listening("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        task = asyncio.create_task(serve(feed, application(feed, None, own_names("127.0.0.1")), listener, stop))
        try:
            yield port
        finally:
            stop.set()
            await asyncio.wait_for(task, 10)


async def opened(port: int, path: bytes = b"/api/stream") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(HEAD % path)
    return reader, writer


async def event(reader: asyncio.StreamReader) -> tuple[str, dict[str, object]]:
    text = (await asyncio.wait_for(reader.readuntil(b"\n\n"), 10)).decode()
    name, data = text.split("event: ")[1].split("\ndata: ")
    return name, json.loads(data)


async def until(done: Callable[[], bool]) -> None:
    for _ in range(600):
        if done():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("never came")


async def closed(writer: asyncio.StreamWriter) -> None:
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()


async def test_a_browser_gets_the_history_and_then_every_view() -> None:
    feed = Feed(Said(*(snapshot(k) for k in range(500))), rate_hz=50)
    async with running(feed) as port:
        await until(lambda: len(feed._history.samples()) > 3)
        reader, writer = await opened(port)
        head = await reader.readuntil(b"\r\n\r\n")
        assert b"text/event-stream" in head
        assert b"x-accel-buffering: no" in head
        name, first = await event(reader)
        assert name == "history"
        assert len(first["samples"]) > 3  # type: ignore[arg-type]
        times, clocks = [], [first["at_s"]]
        for _ in range(3):
            name, said = await event(reader)
            assert name == "view"
            clocks.append(said["at_s"])
            times.append(said["view"]["t_s"])  # type: ignore[index]
        assert times == sorted(set(times))
        assert clocks == sorted(clocks)  # type: ignore[type-var]
        assert 0 <= time.monotonic() - clocks[-1] < 5  # type: ignore[operator]
        await closed(writer)
        await until(lambda: feed.streams == 0)


async def test_the_daemon_is_asked_no_more_often_for_ten_browsers() -> None:
    source = Said(snapshot())
    feed = Feed(source, rate_hz=10)
    async with running(feed) as port:
        streams = [await opened(port) for _ in range(10)]
        await until(lambda: feed.streams == 10)
        before = source.asked
        await asyncio.sleep(1.0)
        assert source.asked - before <= 11
        for _, writer in streams:
            await closed(writer)


async def test_one_browser_too_many_is_told_so() -> None:
    feed = Feed(Said(snapshot()), rate_hz=50, max_streams=2)
    async with running(feed) as port:
        streams = [await opened(port) for _ in range(2)]
        await until(lambda: feed.streams == 2)
        reader, writer = await opened(port)
        assert b" 503 " in await reader.readline()
        await closed(writer)
        await closed(streams.pop()[1])
        await until(lambda: feed.streams == 1)
        reader, writer = await opened(port)
        assert b" 200 " in await reader.readline()
        for _, other in (*streams, (reader, writer)):
            await closed(other)


async def test_a_client_that_does_not_read_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "SEND_S", 0.3)
    heavy = snapshot() | {"notices": [{"text": "x" * 200, "severity": "info", "age_s": 0.0}] * 8}
    feed = Feed(Said(heavy), rate_hz=500)
    async with running(feed) as port:
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.setblocking(False)
            await asyncio.get_running_loop().sock_connect(deaf, ("127.0.0.1", port))
            await asyncio.get_running_loop().sock_sendall(deaf, HEAD % b"/api/stream")
            await until(lambda: feed.streams == 1)
            await until(lambda: feed.streams == 0)


async def test_connections_that_ask_for_nothing_take_nobodys_place_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """What browsers open ahead and leave when they are out of reach: 64 of them, and nobody was answered any more."""
    monkeypatch.setattr(serve_module, "REQUEST_S", 0.5)
    async with running(Feed(Said(snapshot()), rate_hz=50)) as port:
        streaming = await opened(port)
        await event(streaming[0])
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(serve_module.CONNECTIONS)]
        reader, writer = await opened(port, b"/api/status")
        assert b" 503 " in await reader.readline()
        await closed(writer)
        assert [await asyncio.wait_for(reader.read(), 5) for reader, _ in silent] == [b""] * len(silent)
        reader, writer = await opened(port, b"/api/status")
        assert b" 200 " in await reader.readline()
        assert (await event(streaming[0]))[0] == "view"
        for _, other in (*silent, streaming, (reader, writer)):
            await closed(other)


async def test_it_ends_at_once_though_browsers_look() -> None:
    feed = Feed(Said(snapshot()), rate_hz=50)
    clock_s = asyncio.get_running_loop().time
    async with running(feed) as port:
        reader, writer = await opened(port)
        await until(lambda: feed.streams == 1)
        ended_s = clock_s()
    assert clock_s() - ended_s < 1.5
    assert (await reader.read()).endswith(b"0\r\n\r\n")
    await closed(writer)


async def test_a_fault_of_the_source_ends_it_loudly() -> None:
    class Broken(Said):
        async def ask(self) -> dict[str, object]:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        async with running(Feed(Broken({}), rate_hz=50)):
            await asyncio.sleep(0.3)


def test_a_port_that_is_taken_is_said() -> None:
    with listening("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(ConfigError, match=f"127.0.0.1 port {port}: cannot be listened on.*--port"):
            listening("127.0.0.1", port)


@pytest.mark.parametrize("host", ["192.0.2.1", "no such host", "a" * 70 + ".local"])
def test_an_address_that_is_not_of_this_computer_is_said(host: str) -> None:
    with pytest.raises(ConfigError, match="cannot be listened on"):
        listening(host, 0)
