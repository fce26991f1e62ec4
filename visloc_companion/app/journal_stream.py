"""What a journal is written to: its file takes what has gathered whole, or stays as it was."""

from __future__ import annotations

import contextlib
from typing import Any, BinaryIO


class JournalStream:
    """Gathers what is written until `flush`. What the file does not take then (a full disk) waits for the next, so that a
    journal that goes on later has no torn chunk in it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file: Any = getattr(file, "raw", file)  # with a buffer of its own it would be told too late
        self._waiting = bytearray()
        self.kept_bytes = 0

    def write(self, data: bytes) -> int:
        """Gather."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Bytes that were written, be they in the file yet or not."""
        return self.kept_bytes + len(self._waiting)

    def move_to(self, file: BinaryIO) -> None:
        """Write on to another file, which holds what this one does."""
        self._file = getattr(file, "raw", file)

    def flush(self) -> None:
        """Write what has gathered. Raises OSError where the file does not take all of it, and takes back what it took."""
        try:
            left = memoryview(bytes(self._waiting))
            while left:
                left = left[self._file.write(left) :]
            self._file.flush()
        except OSError:
            with contextlib.suppress(OSError, ValueError):
                self._file.seek(self.kept_bytes)
                self._file.truncate()
            raise
        self.kept_bytes += len(self._waiting)
        self._waiting.clear()
