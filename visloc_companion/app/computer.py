"""Looks at how busy this computer is: Linux' /proc and /sys. What is absent there (a container, another system) is None."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

from visloc_companion.types import ComputerLoad

_KIB = 1024
_HOTTEST_C, _COLDEST_C = 150.0, -60.0
"""Sensors that read beyond are broken or not connected."""


class Computer:
    """`look` blocks for as long as reading a few files takes (a slow sensor: some milliseconds).

    `root` is the root of the file system, `storage` the folder whose file system is told of.
    """

    def __init__(self, storage: Path, root: Path = Path("/")) -> None:
        self._root, self._storage = root, storage
        self._ticks: dict[str, tuple[int, int]] = {}

    def look(self) -> ComputerLoad:
        """The load since the last look (at the first: since the computer was started)."""
        memory = memory_bytes(self._root)
        total, available = memory.get("MemTotal"), memory.get("MemAvailable")
        disk = self._disk()
        return ComputerLoad(
            uptime_s=_first_number(_text(self._root / "proc/uptime")),
            cores=self._cores(),
            temperature_c=hottest_c(self._root),
            ram_used_bytes=None if total is None or available is None else total - available,
            ram_total_bytes=total,
            storage_used_bytes=None if disk is None else disk[0],
            storage_total_bytes=None if disk is None else disk[1],
        )

    def _cores(self) -> tuple[float, ...]:
        """Busy share of each core: jiffies that were neither idle nor waiting for a disk (proc(5), /proc/stat)."""
        shares = []
        for line in _text(self._root / "proc/stat").splitlines():
            name, *numbers = line.split() or [""]
            if not (name.startswith("cpu") and name != "cpu" and len(numbers) >= 5):
                continue
            ticks = [int(number) for number in numbers[:8]]
            busy, total = sum(ticks) - ticks[3] - ticks[4], sum(ticks)
            busy_before, total_before = self._ticks.get(name, (0, 0))
            self._ticks[name] = busy, total
            passed = total - total_before
            shares.append(min(1.0, max(0.0, (busy - busy_before) / passed)) if passed > 0 else 0.0)
        return tuple(shares)

    def _disk(self) -> tuple[int, int] | None:
        try:
            usage = shutil.disk_usage(self._storage)
        except OSError:
            return None
        return usage.total - usage.free, usage.total


def memory_bytes(root: Path) -> dict[str, int]:
    """What proc(5), /proc/meminfo, tells by its names ("MemTotal", "SwapFree", ...)."""
    found = {}
    for line in _text(root / "proc/meminfo").splitlines():
        name, _, rest = line.partition(":")
        number = _first_number(rest)
        if number is not None:
            found[name] = int(number) * _KIB
    return found


def computed_s(pid: int, root: Path = Path("/")) -> float | None:
    """Seconds of CPU that a process and its threads have used: utime and stime of proc(5), /proc/PID/stat."""
    fields = _text(root / f"proc/{pid}/stat").rpartition(")")[2].split()
    with contextlib.suppress(ValueError, IndexError):
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
    return None


def hottest_c(root: Path) -> float | None:
    """The hottest of the thermal zones; None where none tells, or no descriptor is left to look."""
    try:
        zones = list((root / "sys/class/thermal").glob("thermal_zone*/temp"))
    except OSError:
        return None
    found = [_first_number(_text(zone)) for zone in zones]
    celsius = [number / 1e3 for number in found if number is not None]
    return max((value for value in celsius if _COLDEST_C < value < _HOTTEST_C), default=None)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


def _first_number(text: str) -> float | None:
    with contextlib.suppress(ValueError, IndexError):
        return float(text.split(maxsplit=1)[0])
    return None


def serial_device(url: str) -> str:
    """The device of a link's URL; empty where it is no serial line."""
    scheme, _, rest = url.partition(":")
    return rest.rpartition(":")[0] if scheme == "serial" else ""


def serial_problem(device: str) -> str:
    """What stands against opening a device (whoever has it open may keep it): empty where nothing does."""
    if not Path(device).exists():
        return f"{device} does not exist"
    return "" if os.access(device, os.R_OK | os.W_OK) else f"no right to use {device}"
