"""The newest time stamp of signing, kept in a file from one start to the next.

A clock that is behind (no battery, no network) would otherwise let recordings of earlier flights be believed. As in ArduPilot,
the stamp is kept every 30 s, and a start begins a minute past it. A thread writes, as for the journal: a card that is slow must
not hold up positions.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path

from visloc_companion.adapters.mavlink.signing import UNITS_PER_S
from visloc_companion.errors import ConfigError, is_of_the_disk
from visloc_companion.whole_file import write_whole

MARGIN = 60 * UNITS_PER_S
_MAX_DIGITS = 15


class StampFile:
    """One line with a whole number. Raises ConfigError where the file cannot be written to at all.

    A disk that fails or is full is told, and no reason to stay away: the daemon may be starting again in flight.
    """

    def __init__(self, path: Path, warn: Callable[[str], None], field: str = "link.signing_stamp_file") -> None:
        self._path, self._warn, self._told = path, warn, False
        self._writing: threading.Thread | None = None
        self._failure: OSError | None = None
        try:
            path.touch(mode=0o600)
        except OSError as why:
            if not is_of_the_disk(why):
                where, remedy = f"{field} = {path}", "name a file in a folder that the daemon may write to"
                raise ConfigError(f"cannot be written: {why.strerror}", where=where, remedy=remedy) from why
            self._tell(why)

    def first(self) -> int:
        """The least stamp to begin with: a minute past the kept one; 0 where none was kept, or it was lost in a power cut."""
        with contextlib.suppress(OSError, ValueError):
            text = self._path.read_text(encoding="ascii").strip()
            if text.isdigit() and len(text) <= _MAX_DIGITS:
                return int(text) + MARGIN
        return 0

    def keep(self, stamp: int) -> None:
        """Have a stamp written, unless the one before still is; a failure (a full disk) is told once, by the next call, and does
        not end anything."""
        if self._failure is not None:
            self._tell(self._failure)
        if self._writing is not None and self._writing.is_alive():
            return
        self._writing = threading.Thread(target=self._write, args=(stamp,), name="signing stamp", daemon=True)
        with contextlib.suppress(RuntimeError):  # the system has no thread to spare: the next one is soon
            self._writing.start()

    def _write(self, stamp: int) -> None:
        try:
            write_whole(self._path, f"{stamp}\n".encode("ascii"))
        except OSError as why:
            self._failure = why

    def _tell(self, why: OSError) -> None:
        if not self._told:
            self._told = True
            self._warn(f"the time of signing cannot be kept in {self._path}: {why.strerror}")
