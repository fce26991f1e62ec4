"""Snapshots from the daemon's socket, the daemon lost and back, and whatever else may listen there."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.unit.web.snapshots import snapshot
from visloc_companion.app.status import status_server
from visloc_companion.web.daemon_socket import MAX_BYTES, DaemonSocket
from visloc_companion.web.feed import Feed
from visloc_companion.web.source import NoAnswer


@asynccontextmanager
async def saying(path: Path, answer: bytes, hold_s: float = 0.0) -> AsyncIterator[None]:
    serving: list[asyncio.Task[None] | None] = []

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        serving.append(asyncio.current_task())
        writer.write(answer)
        await asyncio.sleep(hold_s)
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    server = await asyncio.start_unix_server(serve, path)
    yield
    server.close()
    await asyncio.gather(*(task for task in serving if task is not None))


async def why(path: Path, timeout_s: float = 1.0) -> str:
    with pytest.raises(NoAnswer) as caught:
        await DaemonSocket(path, timeout_s).ask()
    return str(caught.value)


async def test_a_daemon_is_heard_lost_and_heard_again(tmp_path: Path) -> None:
    path, now_s = tmp_path / "status.sock", [0.0]
    feed = Feed(DaemonSocket(path), clock_s=lambda: now_s[0])
    await feed.round()
    assert (feed.view()["state"], feed.view()["says"]) == ("absent", f"No daemon answers at {path}: there is no such socket.")
    async with status_server(path, snapshot, print):
        await feed.round()
        assert feed.view()["state"] == "live"
    now_s[0] = 30.0
    await feed.round()
    lost = feed.view()
    assert (lost["state"], lost["heard_age_s"]) == ("stale", 30.0)
    assert "there is no such socket. Last heard 30 s ago" in lost["says"]
    async with status_server(path, lambda: snapshot(31.0), print):
        await feed.round()
    assert (feed.view()["state"], feed.view()["says"]) == ("live", "")


async def test_the_socket_of_a_killed_daemon(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "s"))
    assert "it has ended" in await why(tmp_path / "s")


async def test_a_daemon_that_hangs_costs_no_more_than_the_timeout(tmp_path: Path) -> None:
    async with saying(tmp_path / "s", b'{"schema": 1', hold_s=0.6):
        assert "does not answer" in await why(tmp_path / "s", timeout_s=0.2)


@pytest.mark.parametrize(
    "answer",
    [b"", b"hello", b"[1]", b'{"schema": 2}', b"\xff\xfe", b"[" * 100_000],
    ids=["none", "text", "list", "newer", "bytes", "deep"],
)
async def test_what_is_no_daemon_is_said(tmp_path: Path, answer: bytes) -> None:
    async with saying(tmp_path / "s", answer):
        assert "no visloc daemon" in await why(tmp_path / "s")


async def test_a_flood_is_not_read_to_its_end(tmp_path: Path) -> None:
    async with saying(tmp_path / "s", b"x" * (MAX_BYTES * 3)):
        assert "no visloc daemon" in await why(tmp_path / "s")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
async def test_a_socket_of_another_user(tmp_path: Path) -> None:
    async with saying(tmp_path / "s", b"{}"):
        (tmp_path / "s").chmod(0)
        assert "may not be read by this user" in await why(tmp_path / "s")


async def test_a_refusal_by_the_system_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def refused(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(asyncio, "open_unix_connection", refused)
    assert "may not be read by this user" in await why(tmp_path / "s")
