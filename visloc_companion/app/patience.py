"""How long a process may take: by the time that it computed, so that a busy computer is not mistaken for a process that hangs.

Killing what only lacks a core makes it worse: the next one first has to start. A process that waits for ever computes nothing,
one that loops for ever uses up its time.
"""

from __future__ import annotations

from pathlib import Path

from visloc_companion.app.computer import computed_s

STARVED_TIMES = 6.0
"""So many times its limit is the most that a process is waited for, however little it was given."""


class Patience:
    """For one piece of work of a process, begun now, that may compute for `limit_s`; asked each `limit_s` whether to go on."""

    def __init__(self, pid: int, limit_s: float, root: Path = Path("/")) -> None:
        self.limit_s = limit_s
        self._pid, self._root = pid, root
        self._begun_s = self._last_s = computed_s(pid, root)
        self._asked = 0

    def lasts(self) -> bool:
        """Whether it computed since the last question, but less than its limit in all. False where that cannot be known."""
        self._asked += 1
        now_s, last_s = computed_s(self._pid, self._root), self._last_s
        if now_s is None or last_s is None or self._begun_s is None:
            return False
        self._last_s = now_s
        return last_s < now_s < self._begun_s + self.limit_s and self._asked < STARVED_TIMES
