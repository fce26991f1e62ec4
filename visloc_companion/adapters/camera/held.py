"""Which processes hold a device: a camera gives its frames to one at a time, and the system says no more than no."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")


def held_by(address: str) -> str:
    """The other processes that have a device open, by number and name, as in "812 (visloc), 901 (cheese)"; empty where none is
    seen: those of other users only root sees. `address`: a path, or the number of /dev/videoN."""
    device = Path(f"/dev/video{address}" if address.isdecimal() else address).resolve()
    if not device.exists():
        return ""
    found = [process for process in PROC.glob("[0-9]*") if process.name != str(os.getpid()) and _holds(process, device)]
    return ", ".join(f"{process.name} ({_name(process)})" for process in sorted(found, key=lambda path: int(path.name)))


def _holds(process: Path, device: Path) -> bool:
    with suppress(OSError):  # another user's, or just gone
        for descriptor in (process / "fd").iterdir():
            with suppress(OSError):
                if descriptor.readlink() == device:
                    return True
    return False


def _name(process: Path) -> str:
    with suppress(OSError):
        return (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    return "?"
