"""The daemon's state for other processes: each connection to a Unix socket gets one JSON snapshot and is closed.

The client pulls, so a slow or dead one cannot make the daemon keep anything: `socat - UNIX-CONNECT:/run/visloc/status.sock`.
The daemon's user and group may ask, so that a dashboard needs not run as the daemon's user.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from visloc_companion.errors import ConfigError, is_of_the_disk

_WRITE_S = 1.0
_MODE = 0o660
"""Who asks must be allowed to write to a socket."""


@contextlib.asynccontextmanager
async def status_server(
    path: Path, snapshot: Callable[[], dict[str, Any]], on_problem: Callable[[str], None]
) -> AsyncIterator[None]:
    """Serve snapshots while the context lasts. Raises ConfigError where the socket cannot be made, or is another daemon's; a disk
    that is full or fails is told to `on_problem`, and nobody is served: the daemon may be starting again in flight."""

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, TimeoutError):
            writer.write(json.dumps(snapshot(), allow_nan=False).encode() + b"\n")
            await asyncio.wait_for(writer.drain(), _WRITE_S)
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    require_nobody(path)
    server: asyncio.Server | None = None
    try:
        _remove(path)  # left by a daemon that was killed
        server = await asyncio.start_unix_server(answer, path)
        _let_the_group_ask(path)
    except OSError as why:
        if not is_of_the_disk(why):
            raise _no_socket(path, why) from why
        on_problem(f"no status socket: {why.strerror}")
    try:
        yield
    finally:
        if server is not None:
            server.close()
        with contextlib.suppress(OSError):  # of a disk that failed meanwhile
            _remove(path)


def require_status_socket(path: Path) -> None:
    """Before anything is opened: make the socket and remove it. Raises ConfigError as `status_server` would."""
    require_nobody(path)
    try:
        check_status_socket(path)
    except ConfigError as none:
        if not is_of_the_disk(none.__cause__):
            raise


def check_status_socket(path: Path) -> None:
    """The same, but the socket of a daemon that runs is left to it. Raises ConfigError where it cannot be made."""
    if _answers(path):
        return
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            _remove(path)
            probe.bind(str(path))
            _remove(path)
        except OSError as why:
            raise _no_socket(path, why) from why


def require_nobody(path: Path) -> None:
    """Raises ConfigError where another daemon answers at this socket."""
    if _answers(path):
        remedy = "stop that one (systemctl stop visloc): two on one link contradict each other; or name another status.socket"
        raise ConfigError("another visloc is running and answers here", where=str(path), remedy=remedy)


def _no_socket(path: Path, why: OSError) -> ConfigError:
    remedy = "name a path in a writable folder"
    if path.is_dir():
        return ConfigError(
            "no status socket: it is a folder", where=str(path), remedy=f"name a file in it: {path / 'status.sock'}"
        )
    if path.parent.parent == Path("/run") and not path.parent.exists():
        remedy = f"the systemd unit makes {path.parent}; by hand: sudo install -d -o USER {path.parent}"
    return ConfigError(f"no status socket: {why}", where=str(path), remedy=remedy)


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(_WRITE_S)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _let_the_group_ask(path: Path) -> None:
    path.chmod(_MODE)


def _remove(path: Path) -> None:
    if path.is_socket():
        path.unlink(missing_ok=True)
