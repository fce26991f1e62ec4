"""Folders of a cache that several processes share: held while they are used, and removed once nobody has used them for long.

A lock (flock) says that a folder is used, by whoever is still running; versions that hold none are allowed for by the time of
the last use.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

UNUSED_S = 7 * 86400.0
"""A folder that nobody has used for so long is not missed: what is in it is made again in a minute."""
REMOVED = ".removed-"
ABANDONED_S = 3600.0
"""A draft in which nothing has changed for so long was left by a process that was killed."""
NOTED_EVERY_S = 3600.0
_held: dict[str, int] = {}
"""Descriptors of the folders that this process uses, by path. They are closed, and so let go, by the end of the process."""


def hold(folder: Path) -> bool:
    """Whether the folder is there, and from now on until this process ends kept from being removed. Its time of use is noted."""
    key = str(folder.absolute())
    if key in _held and _is_still(folder, _held[key]):
        return True
    descriptor = _locked(folder, fcntl.LOCK_SH)  # waits for who gives it a name or takes it, a moment
    if descriptor is None:
        return folder.is_dir()  # a file system without locks
    if key in _held:
        os.close(_held[key])
    _held[key] = descriptor
    with suppress(OSError):  # another user's cache
        if time.time() - folder.stat().st_mtime > NOTED_EVERY_S:
            os.utime(folder)
    return True


@contextmanager
def draft_in(folder: Path, prefix: str) -> Iterator[Path]:
    """A new folder of a name that begins with `prefix` (and a dot, so that it is no result), removed in the end unless it was
    renamed; what killed processes left of such drafts is removed before. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in (*folder.glob(f"{prefix}*"), *folder.glob(f"{REMOVED}*")):
        if time.time() - _changed_at(left) > ABANDONED_S:
            _remove(left)
    draft = Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
    lock = _locked(draft, fcntl.LOCK_EX | fcntl.LOCK_NB)
    try:
        yield draft
    finally:
        if lock is not None:
            os.close(lock)
        shutil.rmtree(draft, ignore_errors=True)


def remove_unused(folders: Iterable[Path]) -> list[Path]:
    """Remove those that no process holds and nobody has used for UNUSED_S, and answer which they were."""
    return [folder for folder in folders if time.time() - _used_at(folder) > UNUSED_S and _remove(folder)]


def _remove(folder: Path) -> bool:
    """Whether a folder that nobody holds was removed: first its name, so that nobody finds half of it."""
    lock = _locked(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    if lock is None:
        return False
    gone = None
    try:
        gone = Path(tempfile.mkdtemp(prefix=REMOVED, dir=folder.parent))
        folder.rename(gone)
    except OSError:
        return False
    finally:
        os.close(lock)
        if gone is not None:
            shutil.rmtree(gone, ignore_errors=True)
    return True


def _locked(folder: Path, how: int) -> int | None:
    """A descriptor that holds the folder of this name; None where there is none, or another process holds it otherwise."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, how)
    except OSError:
        os.close(descriptor)
        return None
    if not _is_still(folder, descriptor):
        os.close(descriptor)
        return None
    return descriptor


def _is_still(folder: Path, descriptor: int) -> bool:
    """Whether the folder of this name is the one that the descriptor is of."""
    try:
        return os.path.samestat(folder.stat(), os.fstat(descriptor))
    except OSError:
        return False


def _used_at(folder: Path) -> float:
    """When a folder was noted as used, or one of its files read or written last: seconds since 1970."""
    times = [0.0]
    with suppress(OSError):
        times.append(folder.stat().st_mtime)
        for path in folder.rglob("*"):
            if path.is_file():
                times += [path.stat().st_atime, path.stat().st_mtime]
    return max(times)


def _changed_at(folder: Path) -> float:
    """When the folder or anything in it was changed last: seconds since 1970."""
    with suppress(OSError):
        return max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
    return time.time()
