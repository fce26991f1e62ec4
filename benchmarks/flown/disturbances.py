"""What may happen to the daemon's processes (benchmarks/disturbed.py), and what they hold meanwhile."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from visloc_companion.sim.server import ServerPlan

BEGIN_S, SETTLED_S, LOOK_EVERY_S = 30.0, 20.0, 5.0
"""Seconds after both were started: the first disturbance; what a process holds is looked at from then on, so often."""
PAUSE_S = 6.0, 18.0
BUSY = "import time; end = time.monotonic() + 8\nwhile time.monotonic() < end: pass"
Daemon = subprocess.Popen[bytes]


@dataclass(frozen=True, slots=True)
class Taken:
    """What a process holds."""

    t_s: float
    resident_mib: float
    files: int


class Disturber:
    """Disturbs a daemon as a seed draws it (demo_processes.Disturb), and notes what was done and what its processes hold."""

    def __init__(self, seed: int, kinds: Sequence[str]) -> None:
        self.done: list[str] = []
        self.longest_stop_s = 0.0
        self.daemon: list[Taken] = []
        self.worker: list[Taken] = []
        self._random, self._kinds = random.Random(seed), list(kinds)
        self._begun_s, self._due_s, self._looked_s = time.monotonic(), BEGIN_S, SETTLED_S - LOOK_EVERY_S

    def __call__(self, plan: ServerPlan, daemon: Daemon) -> None:
        """Look, and disturb where it is time."""
        now_s = time.monotonic() - self._begun_s
        if now_s - self._looked_s > LOOK_EVERY_S:
            self._looked_s = now_s
            self._look(now_s, daemon)
        if self._kinds and now_s > self._due_s:
            kind = self._random.choice(self._kinds)
            stopped_s = KINDS[kind](self._random, plan, daemon)
            self.longest_stop_s = max(self.longest_stop_s, stopped_s)
            self.done.append(kind)
            self._due_s = time.monotonic() - self._begun_s + self._random.uniform(*PAUSE_S)

    def as_json(self) -> dict[str, Any]:
        """All that was noted."""
        return {"done": self.done} | {
            name: [asdict(one) for one in taken] for name, taken in (("daemon", self.daemon), ("worker", self.worker))
        }

    def _look(self, now_s: float, daemon: Daemon) -> None:
        with contextlib.suppress(OSError):
            self.daemon.append(_taken(now_s, daemon.pid))
        for pid in _workers(daemon):
            with contextlib.suppress(OSError):
                self.worker.append(_taken(now_s, pid))


def _taken(t_s: float, pid: int) -> Taken:
    """Raises OSError where there is no such process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return Taken(t_s, pages * os.sysconf("SC_PAGE_SIZE") / 2**20, len(list(Path(f"/proc/{pid}/fd").iterdir())))


def _workers(daemon: Daemon) -> Iterator[int]:
    """The localising process, where there is one: the child of the daemon that multiprocessing spawned to work."""
    try:
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
    except OSError:
        return
    for pid in map(int, children):
        with contextlib.suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                yield pid


# Each returns the seconds for which the daemon itself was stopped.


def _kill_worker(_: random.Random, __: ServerPlan, daemon: Daemon) -> float:
    for pid in _workers(daemon):
        _signal(pid, signal.SIGKILL)
    return 0.0


def _stop_worker(drawn: random.Random, _: ServerPlan, daemon: Daemon) -> float:
    workers = list(_workers(daemon))
    _stopped(workers, drawn.uniform(0.5, 8.0))
    return 0.0


def _stop_daemon(drawn: random.Random, _: ServerPlan, daemon: Daemon) -> float:
    return _stopped([daemon.pid], drawn.uniform(0.3, 3.0))


def _noise(drawn: random.Random, plan: ServerPlan, _: Daemon) -> float:
    _send(plan, (drawn.randbytes(drawn.randint(1, 1500)) for _ in range(2000)))
    return 0.0


def _broken_packets(drawn: random.Random, plan: ServerPlan, _: Daemon) -> float:
    _send(plan, (b"\xfd" + drawn.randbytes(drawn.randint(1, 280)) for _ in range(200)))
    return 0.0


def _clients(_: random.Random, plan: ServerPlan, __: Daemon) -> float:
    with contextlib.ExitStack() as stack:
        for _ in range(100):
            client = stack.enter_context(socket.socket(socket.AF_UNIX))
            client.settimeout(1.0)
            with contextlib.suppress(OSError):  # the queue of those who wait is full, or there is no socket
                client.connect(str(Path(plan.result).parent / "status.sock"))
        time.sleep(1.0)
    return 0.0


def _busy(_: random.Random, __: ServerPlan, ___: Daemon) -> float:
    running = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(4)]
    for process in running:
        process.wait()
    return 0.0


def _stopped(pids: list[int], seconds: float) -> float:
    begun_s = time.monotonic()
    for pid in pids:
        _signal(pid, signal.SIGSTOP)
    time.sleep(seconds)
    for pid in pids:
        _signal(pid, signal.SIGCONT)
    return time.monotonic() - begun_s


def _signal(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def _send(plan: ServerPlan, packets: Iterator[bytes]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for packet in packets:
            link.sendto(packet, ("127.0.0.1", plan.mavlink_port))


KINDS: dict[str, Callable[[random.Random, ServerPlan, Daemon], float]] = {
    "worker killed": _kill_worker,
    "worker stopped": _stop_worker,
    "daemon stopped": _stop_daemon,
    "noise": _noise,
    "broken packets": _broken_packets,
    "clients": _clients,
    "busy cores": _busy,
}
