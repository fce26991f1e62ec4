"""Keeps the folder of the journals from filling the disk: the oldest go before a new one begins, where the configuration says so.

Nothing but journals under the daemon's own names counts: one that was renamed stays.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

_NAMES = "visloc-*.mcap"


def outgrown(folder: Path, keep_bytes: int) -> dict[Path, int]:
    """The oldest journals of a folder, with their sizes, without which the others take no more than so many bytes; none with 0.

    The newest is never among them: it is that of the flight before, or of this one where the daemon starts again in flight. Age
    is that of the last write: a computer without a clock names the journals of all its days alike, and `delete_outgrown` sees to
    one whose clock went back. What cannot be looked at is left.
    """
    if keep_bytes == 0:
        return {}
    found: list[tuple[int, str, Path, int]] = []
    for path in folder.glob(_NAMES):
        with contextlib.suppress(OSError):
            of = path.lstat()
            found.append((of.st_mtime_ns, path.name, path, of.st_size))
    over = sum(size for *_, size in found) - keep_bytes
    gone: dict[Path, int] = {}
    for _, _, path, size in sorted(found)[:-1]:
        if over <= 0:
            break
        gone[path], over = size, over - size
    return gone


def delete_outgrown(folder: Path, keep_bytes: int) -> list[Path]:
    """Delete them; which are gone. One that cannot be deleted stays: it is no reason not to fly."""
    if keep_bytes:
        _date_back(folder, time.time_ns())
    gone = []
    for path in outgrown(folder, keep_bytes):
        with contextlib.suppress(OSError):
            path.unlink()
            gone.append(path)
    return gone


def _date_back(folder: Path, now_ns: int) -> None:
    """Date journals of after now to now, in their order: the computer's clock went back since they were written (no battery, no
    network), and what is written from now on, that of this flight first, would be older than they are."""
    later = []
    for path in folder.glob(_NAMES):
        with contextlib.suppress(OSError):
            if (written_ns := path.lstat().st_mtime_ns) > now_ns:
                later.append((written_ns, path.name, path))
    for age, (_, _, path) in enumerate(sorted(later, reverse=True)):
        with contextlib.suppress(OSError):
            os.utime(path, ns=(now_ns, now_ns - age), follow_symlinks=False)
