"""Asks the daemon for a snapshot: one connection to its status socket each time (app/status.py)."""

from __future__ import annotations

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Any

from visloc_companion.web.source import NoAnswer
from visloc_companion.web.view import Origin

MAX_BYTES = 1_000_000
TIMEOUT_S = 1.0


class DaemonSocket:
    """source.Source of a daemon that runs on this computer."""

    def __init__(self, path: Path, timeout_s: float = TIMEOUT_S) -> None:
        self._path, self._timeout_s = path, timeout_s
        self.origin = Origin(str(path))

    async def ask(self) -> dict[str, Any]:
        """One snapshot. Raises NoAnswer saying what is there instead."""
        try:
            answer = await asyncio.wait_for(self._read(), self._timeout_s)
        except TimeoutError:
            raise NoAnswer(f"A daemon listens at {self._path}, but does not answer.") from None
        except FileNotFoundError:
            raise NoAnswer(f"No daemon answers at {self._path}: there is no such socket.") from None
        except ConnectionRefusedError:
            raise NoAnswer(f"No daemon answers at {self._path}: it has ended.") from None
        except PermissionError:
            raise NoAnswer(
                f"The socket {self._path} may not be read by this user: run visloc web as the daemon's user, or as root."
            ) from None
        except OSError as why:
            raise NoAnswer(f"No daemon answers at {self._path}: {why.strerror or why}.") from None
        return self._parsed(answer)

    async def _read(self) -> bytes:
        reader, writer = await asyncio.open_unix_connection(self._path)
        try:
            parts, size = [], 0
            while (part := await reader.read(65536)) and size <= MAX_BYTES:
                parts.append(part)
                size += len(part)
            return b"".join(parts)
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def _parsed(self, answer: bytes) -> dict[str, Any]:
        if len(answer) <= MAX_BYTES:
            with contextlib.suppress(ValueError, RecursionError):
                snapshot = json.loads(answer)
                if isinstance(snapshot, dict) and snapshot.get("schema") == 1:
                    return snapshot
        raise NoAnswer(f"What answers at {self._path} is no visloc daemon, or one of another version.")
