"""How long a flight's processes computed, and how long they waited for a core: tells a busy computer from a fault.

Linux counts both for each thread, in nanoseconds (`/proc/PID/task/TID/schedstat`, Documentation/scheduler/sched-stats).
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

_NS_PER_S = 1e9
LONG_S, TICK_S = 0.1, 0.1
"""Of the fifth of a second between two looks; and between two positions that are due, in the flight's own time."""


@dataclass(frozen=True, slots=True)
class CoreWaits:
    """Of all processes together, seconds of computing and of waiting for a core; and the longest wait of the daemon's main
    thread, which sends the positions, between two looks in which it waited longer than it computed. `speed`: the flight's,
    times real time."""

    computed_s: float
    waited_s: float
    longest_s: float
    speed: float

    @property
    def busy(self) -> bool:
        """Whether they got less than half of the time that they could have used (three processes that share two cores get two
        thirds), or the daemon had to let a position's time pass."""
        return self.waited_s > self.computed_s or self.longest_s >= max(LONG_S, TICK_S / self.speed)

    def told(self) -> str:
        """What was measured, what follows from it, and what to do."""
        measured = (
            f"daemon and autopilot computed for {self.computed_s:.0f} s and waited for a core for {self.waited_s:.0f} s, "
            f"the daemon's main thread up to {1e3 * self.longest_s:.0f} ms at once"
        )
        if self.busy:
            return f"was busy: {measured}. That alone makes positions late: run it again with nothing beside it"
        return f"was not too busy: {measured}. Look for a fault, in the report and in daemon.log"

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")


def load_waits(path: Path) -> CoreWaits | None:
    """What was saved; None where the kernel did not tell (no such file)."""
    return CoreWaits(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


class WaitsOf:
    """Looks at processes and all that they started, as often as it is asked to; what threads did before the first look is not
    counted, and of one that ends what it did after the last."""

    def __init__(self, daemon: int, *others: int) -> None:
        """`daemon`, `others`: ids of processes."""
        self._daemon, self._pids = daemon, (daemon, *others)
        self._first: dict[int, tuple[int, int]] = {}
        self._last: dict[int, tuple[int, int]] = {}
        self._longest_ns = 0

    def look(self) -> None:
        """Note where the counters of all threads stand."""
        begun = bool(self._last)
        for pid in _with_children(self._pids):
            for thread in _threads(pid):
                stands = _counters(pid, thread)
                if stands is None:
                    continue
                before = self._last.get(thread)
                if thread == self._daemon and before is not None:
                    computed_ns, waited_ns = (now - then for now, then in zip(stands, before, strict=True))
                    self._longest_ns = max(self._longest_ns, waited_ns if waited_ns > computed_ns else 0)
                self._first.setdefault(thread, (0, 0) if begun else stands)
                self._last[thread] = stands

    def found(self, speed: float) -> CoreWaits | None:
        """What was counted between the first look and the last; None where the kernel tells nothing."""
        if not self._last:
            return None
        computed, waited = (math.fsum(self._last[tid][k] - self._first[tid][k] for tid in self._last) for k in (0, 1))
        return CoreWaits(computed / _NS_PER_S, waited / _NS_PER_S, self._longest_ns / _NS_PER_S, speed)


def _counters(pid: int, thread: int) -> tuple[int, int] | None:
    """Nanoseconds that a thread computed and waited for a core; None where it ended or the kernel does not count."""
    with suppress(OSError, ValueError):
        computed, waited, *_ = Path(f"/proc/{pid}/task/{thread}/schedstat").read_text(encoding="ascii").split()
        return int(computed), int(waited)
    return None


def _threads(pid: int) -> list[int]:
    with suppress(OSError):
        return [int(path.name) for path in Path(f"/proc/{pid}/task").iterdir()]
    return []


def _with_children(pids: tuple[int, ...]) -> list[int]:
    found = list(pids)
    for pid in found:
        for thread in _threads(pid):
            with suppress(OSError):
                found += map(int, Path(f"/proc/{pid}/task/{thread}/children").read_text(encoding="ascii").split())
    return found
