"""Reads this computer: what Linux tells in /proc and /sys. Where a file is missing the value is None."""

from __future__ import annotations

import contextlib
import os
import shutil
import struct
import subprocess
from pathlib import Path

from visloc_companion.app.computer import hottest_c, memory_bytes, serial_device, serial_problem
from visloc_companion.app.journal_folder import outgrown
from visloc_companion.app.parts import check_journal_folder
from visloc_companion.config import Config
from visloc_companion.doctor.facts import SystemFacts
from visloc_companion.errors import VislocError

_TIMEOUT_S = 3.0


def read_system(config: Config, root: Path = Path("/")) -> SystemFacts:
    """The state of this computer. `root` stands for the file system in tests."""
    memory = {name: size / 1024**2 for name, size in memory_bytes(root).items()}
    device = serial_device(config.link.url)
    folder = Path(config.journal.folder) if config.journal.folder else None
    return SystemFacts(
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        memory_free_mb=memory.get("MemAvailable"),
        swap_used_mb=memory["SwapTotal"] - memory["SwapFree"] if {"SwapTotal", "SwapFree"} <= set(memory) else None,
        temperature_c=hottest_c(root),
        governor=_text(root / "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        clock_synchronised=clock_synchronised(),
        bits=8 * struct.calcsize("P"),
        disk_free_mb=None if folder is None else _disk_free_mb(folder, config.journal.keep_bytes),
        journal_problem="" if folder is None else _journal_problem(config),
        serial_problem=serial_problem(device) if device else "",
        console_on_serial=_console(root, device),
    )


def clock_synchronised() -> bool | None:
    """What systemd says of the system clock (chrony tells systemd, too); None without systemd."""
    program = shutil.which("timedatectl")
    if program is None:
        return None
    asked = [program, "show", "--property=NTPSynchronized", "--value"]
    try:
        answer = subprocess.run(asked, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    said = answer.stdout.strip()
    return said == "yes" if answer.returncode == 0 and said in ("yes", "no") else None


def _text(path: Path) -> str | None:
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.read_text(encoding="ascii").strip()
    return None


def _disk_free_mb(folder: Path, keep_bytes: int) -> float | None:
    """What a new journal finds: with what the daemon deletes before it begins one."""
    with contextlib.suppress(OSError):
        gone = sum(outgrown(folder, keep_bytes).values())
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        return (shutil.disk_usage(folder).free + gone) / 1e6
    return None


def _journal_problem(config: Config) -> str:
    try:
        check_journal_folder(config)
    except VislocError as why:
        return str(why)
    return ""


def _console(root: Path, device: str) -> bool | None:
    told = _text(root / "proc/cmdline")
    if told is None or not device:
        return None
    name = Path(os.path.realpath(device)).name
    return any(word.startswith("console=") and word[8:].partition(",")[0] == name for word in told.split())
