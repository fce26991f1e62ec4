"""Snapshots over a Unix socket."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import socket
import stat
from pathlib import Path

import pytest

from tests.unit.app.daemon import configuration, flight, hovering
from visloc_companion.app.status import check_status_socket, require_status_socket, status_server
from visloc_companion.errors import ConfigError


async def ask(path: Path) -> object:
    reader, writer = await asyncio.open_unix_connection(path)
    answer = await reader.read()
    writer.close()
    await writer.wait_closed()
    return json.loads(answer)


async def test_every_connection_gets_one_snapshot(tmp_path: Path) -> None:
    path, n = tmp_path / "status.sock", iter(range(9))
    async with status_server(path, lambda: {"n": next(n)}, print):
        assert [await ask(path) for _ in range(3)] == [{"n": 0}, {"n": 1}, {"n": 2}]
    assert not path.exists()


async def test_the_daemons_group_may_ask_and_nobody_else(tmp_path: Path) -> None:
    path, before = tmp_path / "status.sock", os.umask(0o027)
    try:
        async with status_server(path, dict, print):
            assert stat.S_IMODE(path.stat().st_mode) == 0o660
    finally:
        os.umask(before)


async def test_a_socket_left_by_a_killed_daemon_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "status.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    async with status_server(path, lambda: {"alive": True}, print):
        assert await ask(path) == {"alive": True}


async def test_the_socket_of_a_daemon_that_runs_is_left_to_it(tmp_path: Path) -> None:
    path = tmp_path / "status.sock"
    async with status_server(path, lambda: {"who": "first"}, print):
        with pytest.raises(ConfigError, match="another visloc is running"):
            async with status_server(path, lambda: {"who": "second"}, print):
                pass
        assert await ask(path) == {"who": "first"}


async def test_a_check_makes_the_socket_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "status.sock"
    check_status_socket(path)
    assert not path.is_socket()
    async with status_server(path, lambda: {"who": "first"}, print):
        check_status_socket(path)
        assert await ask(path) == {"who": "first"}


def test_a_check_names_who_makes_the_folder_of_a_service() -> None:
    with pytest.raises(ConfigError, match=r"sudo install -d -o USER /run/visloc-of-a-test$"):
        check_status_socket(Path("/run/visloc-of-a-test/status.sock"))


@pytest.mark.parametrize("name", ["none/status.sock", "file", "x" * 120])
def test_a_check_finds_a_path_that_cannot_be(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("precious")
    with pytest.raises(ConfigError, match="name a path in a writable folder"):
        check_status_socket(tmp_path / name)
    assert (tmp_path / "file").read_text() == "precious"


async def test_a_client_that_goes_away_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "status.sock"
    async with status_server(path, lambda: {"x": "y" * 2_000_000}, print):
        with socket.socket(socket.AF_UNIX) as rude:
            rude.connect(str(path))
        await asyncio.sleep(0.05)
        assert isinstance(await ask(path), dict)


async def test_a_path_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("precious")
    with pytest.raises(ConfigError, match="no status socket"):
        async with status_server(tmp_path / "none" / "status.sock", dict, print):
            pass


def test_a_folder_is_told_as_one(tmp_path: Path) -> None:
    """It was "Address already in use", and the remedy a writable folder, which it was."""
    with pytest.raises(ConfigError, match=rf"it is a folder; remedy: name a file in it: {tmp_path}/status.sock"):
        check_status_socket(tmp_path)


@pytest.mark.parametrize("fault", [errno.EROFS, errno.ENOSPC, errno.EIO])
async def test_a_disk_that_fails_is_told_and_keeps_no_daemon_from_starting_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    """A start that is refused for its configuration is not tried again by systemd; a check before the flight says it."""
    path, told = tmp_path / "status.sock", list[str]()

    async def fails(*_: object) -> None:
        raise OSError(fault, os.strerror(fault))

    def binds(*_: object) -> None:
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(asyncio, "start_unix_server", fails)
    monkeypatch.setattr(socket.socket, "bind", binds)
    require_status_socket(path)
    with pytest.raises(ConfigError, match="no status socket"):
        check_status_socket(path)
    async with status_server(path, dict, told.append):
        assert told == [f"no status socket: {os.strerror(fault)}"]


async def test_positions_that_the_link_keeps_back_are_not_told_as_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    async with flight(configuration(tmp_path)) as f, hovering(f):
        await f.until(lambda: len(f.link.injections) > 3, "injections")
        before = f.daemon.snapshot()["injections"]
        assert before["withheld"] == ""
        assert not f.daemon._condition().critical
        f.link.withheld = "too far outside the map"
        n = len(f.link.injections)
        await f.until(lambda: f.daemon._injections.taken > before["sent"] + 10, "ten that are kept back")
        told = f.daemon.snapshot()["injections"]
        assert told["withheld"] == "too far outside the map"
        assert f.daemon._condition().critical, "what the heartbeat shows"
        assert abs(told["sent"] - n) <= 1
        assert len(f.link.injections) == n
