"""Lines of the log, written by a thread of its own: they go to a disk that may be full, or to a reader that may have stalled.

What cannot be written is lost; the journal has the notices all the same.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading

CAPACITY = 1000
CLOSE_S = 1.0


class LogLines:
    """The file that structlog prints to. `write` and `flush` never wait and never raise; `lost` counts what went nowhere."""

    def __init__(self, descriptor: int) -> None:
        self.lost, self._closed = 0, False
        self._descriptor = descriptor
        self._queue: queue.Queue[bytes | None] = queue.Queue(CAPACITY)
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue a text; how long it is."""
        try:
            self._queue.put_nowait(text.encode(errors="backslashreplace"))
        except queue.Full:
            self.lost += 1
        return len(text)

    def flush(self) -> None:
        """Nothing is kept back."""

    def close(self) -> None:
        """Write what waits; at most `CLOSE_S` is waited for who does not take it."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=CLOSE_S)
        self._thread.join(CLOSE_S)
        self._closed = True

    def _run(self) -> None:
        while not self._closed and (left := self._queue.get()) is not None:
            try:
                while left:
                    left = left[os.write(self._descriptor, left) :]
            except OSError:
                self.lost += 1
