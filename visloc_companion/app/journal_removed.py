"""A journal whose file is removed while it is written (a clean-up of old files, logrotate, a slip): it is made anew.

The removed file stays as it is for who holds it open, so nothing of the flight is lost until it is closed. Who wanted its room
would not have got it before the flight's end, and a flight without a record is not to be had back (decision 121).
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from visloc_companion.app import journal_lock

COPIED_AT_ONCE = 16_000_000
"""Bytes each second: what comes meanwhile waits in a queue."""
_PIECE = 1 << 20
_MADE = "journal was removed, is made anew"
_TRY_AGAIN_S = 5.0


def is_there(stream: BinaryIO, path: Path) -> bool:
    """Whether a file that is open still has a name, or something else has its name now. Raises OSError."""
    return os.fstat(stream.fileno()).st_nlink > 0 or path.exists()


def require_there(stream: BinaryIO, path: Path) -> None:
    """Raises FileNotFoundError where it has none."""
    if not is_there(stream, path):
        raise FileNotFoundError(errno.ENOENT, "its file was removed")


class MadeAnew:
    """Copies a removed journal to a new file of its name, a part at a time while the flight goes on. `report` is told."""

    def __init__(self, path: Path | None, report: Callable[[str], None]) -> None:
        self._path, self._report = path, report
        self._copy: BinaryIO | None = None
        self._copied = 0
        self._again_s = 0.0
        self._told: tuple[str, ...] = ()

    def made(self, stream: BinaryIO, n_bytes: int, *, whole: bool = False) -> BinaryIO | None:
        """The new file, open behind its last byte, once it holds the `n_bytes` that were written; None before, and where the
        journal's file is there. One that cannot be made is tried again, once in `_TRY_AGAIN_S`. Never raises."""
        if self._path is None or (time.monotonic() < self._again_s and not whole):
            return None
        try:
            return self._made(stream, self._path, n_bytes, whole=whole)
        except (OSError, ValueError) as why:  # no room, no right; of a stream without a file
            self._again_s = time.monotonic() + _TRY_AGAIN_S
            self._tell(f"journal removed, not made anew: {getattr(why, 'strerror', None) or why}")
            self._give_up()
            return None

    def _made(self, stream: BinaryIO, path: Path, n_bytes: int, *, whole: bool) -> BinaryIO | None:
        if self._copy is not None and not is_there(self._copy, path):
            self._give_up()
        if self._copy is None:
            if is_there(stream, path):
                self._told = ()
                return None
            path.parent.mkdir(parents=True, exist_ok=True)
            self._copy, self._copied = path.open("x+b", buffering=0), 0
            journal_lock.hold(self._copy)
            if not self._told:
                self._tell(_MADE)
        until = n_bytes if whole else min(n_bytes, self._copied + COPIED_AT_ONCE)
        while self._copied < until:
            piece = os.pread(stream.fileno(), min(_PIECE, until - self._copied), self._copied)
            self._copied += self._copy.write(piece)
        if self._copied < n_bytes:
            return None
        os.fsync(self._copy.fileno())
        self._tell(_MADE)  # where it failed before
        made, self._copy = self._copy, None
        return made

    def _give_up(self) -> None:
        """Leave no part of a journal beside the one that is written: as the newest it would be kept in its place."""
        copy, self._copy = self._copy, None
        if copy is not None and self._path is not None:
            with contextlib.suppress(OSError):
                if os.fstat(copy.fileno()).st_nlink:
                    self._path.unlink()
            with contextlib.suppress(OSError):
                copy.close()

    def _tell(self, text: str) -> None:
        if text not in self._told:
            self._told = (*self._told, text)
            self._report(text)
