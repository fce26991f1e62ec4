"""What a daemon leaves to the one after it: that the autopilot was being sent positions, in a file beside the status socket.

A daemon that is started again in flight finds an autopilot that may be on vision. While GNSS is false or away it goes on by
itself (core/telemetry.py); where GNSS is good again nothing would tell it that positions are needed until somebody has brought
the autopilot back. No message of ArduPilot names its source. The file lies where the socket does, in memory (/run): writing it
holds up nothing, and a start of the computer forgets it. With it goes which map pack was verified: hashing a large one again
takes as long as there is until the autopilot's failsafe.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import structlog

from visloc_companion.types import Command, Event, FoundOnVision, Injection, LinkChanged, Mode, Status
from visloc_companion.whole_file import write_whole

log = structlog.get_logger("visloc")

WRITE_EVERY_NS = 2_000_000_000
FRESH_NS = 120_000_000_000
"""An autopilot that was sent nothing for longer flies on something else, or has landed."""
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class Left:
    """What a daemon left: which autopilot was sent positions, with which reset counter, and its `WorkerSupervisor.pack_seal`."""

    system_id: int
    reset_counter: int = 0
    pack_seal: str = ""
    boot_time_ns: int = 0

    def is_fresh(self, now_ns: int) -> bool:
        """Whether it was left a short while ago, at a time since the computer's start."""
        return 0 <= now_ns - self.boot_time_ns <= FRESH_NS


def boot_time_ns() -> int:
    """Time since the computer's start, also while it slept."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def _left_behind(file: Path | None, now_ns: int) -> Left | None:
    if file is None:
        return None
    try:
        left = json.loads(file.read_text(encoding="utf-8"))
        known = int(left["system_id"]), int(left.get("reset_counter", 0)), str(left.get("pack_seal", ""))
        found = Left(*known, int(left["boot_time_ns"]))
        return found if left["boot_id"] == _boot_id() and found.is_fresh(now_ns) else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError) as why:
        log.warning("what the daemon before left cannot be read", file=str(file), why=str(why))
        return None


class Handover:
    """Reads the file of the daemon before, and keeps this one's. Without a status socket there is none.

    `left` is what the daemon before left a short while ago; None for nothing, and for a file that cannot be read, which is told.
    """

    def __init__(self, socket: str, now_ns: Callable[[], int] = boot_time_ns) -> None:
        """`now_ns`: time since the computer's start."""
        self._file = _file_of(socket)
        self._now_ns = now_ns
        self._system_id = 0
        self._written_ns: int | None = None
        self._failed = False
        self._left = self.left = _left_behind(self._file, now_ns())

    def heard(self, event: Event) -> FoundOnVision | None:
        """Take an event of the link; the first one of a flying autopilot that the daemon before sent positions to says so."""
        if not isinstance(event, LinkChanged) or not event.up:
            return None
        left, self._left, self._system_id = self._left, None, event.system_id
        if left is None or not event.armed or left.system_id != event.system_id or not left.is_fresh(self._now_ns()):
            return None
        return FoundOnVision(event.t_rx_ns, left.reset_counter)

    def did(self, command: Command, pack_seal: str = "") -> None:
        """Take what the navigator commands: positions are noted, and that they are needed no more. `pack_seal`: of the pack that
        this daemon has verified (worker.py)."""
        if isinstance(command, Injection):
            self._note(command.reset_counter, pack_seal)
        elif (
            isinstance(command, Status) and command.mode is Mode.SHADOW and not command.injected and self._written_ns is not None
        ):
            self._written_ns = None
            self._change(lambda file: file.unlink(missing_ok=True))

    def _note(self, reset_counter: int, pack_seal: str) -> None:
        now_ns = self._now_ns()
        if self._written_ns is not None and now_ns - self._written_ns < WRITE_EVERY_NS:
            return
        self._written_ns = now_ns
        left = Left(self._system_id, reset_counter, pack_seal, now_ns)
        text = json.dumps({"boot_id": _boot_id(), **asdict(left)})
        self._change(lambda file: write_whole(file, text.encode()))

    def _change(self, change: Callable[[Path], None]) -> None:
        if self._file is None:
            return
        try:
            change(self._file)
        except OSError as why:  # it is tried again: a file system that is full may have room soon
            if not self._failed:
                log.warning("cannot note that the autopilot is sent positions", file=str(self._file), why=str(why))
            self._failed = True


def _file_of(socket: str) -> Path | None:
    return Path(socket).with_suffix(".on-vision") if socket else None


def _boot_id() -> str:
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""
