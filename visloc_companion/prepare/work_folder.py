"""A folder in the making, beside the one it will replace: what of it is done survives being broken off."""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from visloc_companion.errors import MapError, VislocError
from visloc_companion.maps.manifest import FileEntry, sha256_file

LOG = ".work.jsonl"
SYNC_S = 2.0
"""At most so much work, and one part, is lost where it is broken off."""
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_libc = ctypes.CDLL(None)
Progress = Callable[[str, float], None]
"""Called with the name of the stage and the share of it (0 to 1) that is done."""


class WorkFolder:
    """`.NAME.building` beside the target `NAME`, with a log of the finished parts of the work.

    `key` says what the work is made from: a folder that was left behind with the same key is gone on with, another one is
    emptied. A part is noted only after its data were handed to the disk, so that even a loss of power costs SYNC_S at most.
    One process at a time: a second one gets a MapError. As a context it is closed at the end, and removed by a VislocError: what
    is refused once is refused again. What the disk refuses (OSError) becomes a MapError, and leaves the folder to go on with, and
    so does too little space of it, where something is done.
    A target that is a link is followed: the work lies on the disk that will hold it.
    """

    def __init__(self, target: Path, key: str) -> None:
        with ExitStack() as held:
            is_new = False
            try:
                self.target = target.resolve()
                self.path = self.target.with_name(f".{self.target.name}.building")
                is_new = not self.path.exists()
                self.path.mkdir(parents=True, exist_ok=True)
                folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
                held.callback(os.close, folder)
                self._lock(folder)  # it lasts until the folder has its name, the log goes before
                self._log = (self.path / LOG).open("a+", encoding="utf-8", errors="replace")
                held.callback(_closed, self._log)
                self._lock(self._log.fileno())  # where folders know no locks (NFS)
                self._pending: dict[str, tuple[object, Callable[[], object] | None]] = {}
                self._synced_at = time.monotonic()
                self._done = self._read(key)
                self._is_spared = False
                if not self._done:
                    self._start(key)
            except OSError as why:
                if is_new:
                    shutil.rmtree(self.path, ignore_errors=True)
                raise MapError(
                    f"no folder can be made there: {why.strerror}",
                    where=str(target),
                    remedy="name a place that can be written to",
                ) from why
            self._held = held.pop_all()

    def __enter__(self) -> Self:
        """The folder itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, trace: TracebackType | None) -> None:
        """Remove after a refusal; else only let go."""
        if isinstance(why, VislocError) and not self._is_spared:
            self.remove()
        with suppress(OSError):  # closing writes what is left
            self.close()
        if isinstance(why, OSError):
            raise MapError(
                f"cannot be written: {why.strerror} ({_size(shutil.disk_usage(self.path.parent).free)} are free there)",
                where=str(why.filename or self.path),
                remedy="check the disk and its free space, then give the command again: it goes on with what is done",
            ) from why

    def result(self, part: str) -> Any:
        """What a finished part was recorded with; None where it is not finished."""
        return self._done.get(part)

    def record(self, part: str, result: object = True, flush: Callable[[], object] | None = None) -> None:
        """Note that a part is finished. `flush` hands its data to the disk; it is called at the latest after some seconds, and
        only then the part counts: waiting for the disk after each small part would take longer than the work."""
        self._done[part] = result
        self._pending[part] = (result, flush)
        if time.monotonic() - self._synced_at >= SYNC_S:
            self.sync()

    def sync(self) -> None:
        """Hand everything that is finished to the disk, and note it in the log."""
        for flush in {id(flush): flush for _, flush in self._pending.values() if flush is not None}.values():
            flush()
        self._log.writelines(json.dumps({part: result}) + "\n" for part, (result, _) in self._pending.items())
        self._log.flush()
        os.fsync(self._log.fileno())
        self._pending.clear()
        self._synced_at = time.monotonic()

    def hashed(self, names: Sequence[str], report: Progress, known: dict[str, FileEntry] | None = None) -> dict[str, FileEntry]:
        """Size and SHA-256 of the files of these names, which are on the disk after that; any other file is removed.

        `known` entries are taken as they are.
        """
        for path in self.path.iterdir():
            if path.name not in names and path.name != LOG:
                path.unlink()
        entries = dict(known or {})
        for n, name in enumerate(names):
            path = self.path / name
            if name not in entries:
                synced(path)
                entries[name] = FileEntry(bytes=path.stat().st_size, sha256=sha256_file(path))
            report("hashes", (n + 1) / len(names))
        return dict(sorted(entries.items()))

    def check_free(self, need_bytes: float) -> None:
        """Raise MapError where the disk lacks space, counting what was left in the folder by work that was broken off."""
        there = sum(path.stat().st_blocks * 512 for path in self.path.iterdir())
        free = shutil.disk_usage(self.path).free
        if free + there < need_bytes * 1.05:
            self._is_spared = len(self._done) > 1  # more than the key
            raise MapError(
                f"needs {_size(need_bytes)} of disk, {_size(free + there)} are free",
                where=str(self.target.parent),
                remedy="free space, build elsewhere, or store features of coarser levels only (--finest-features-m)",
            )

    def take_name(self) -> None:
        """Give the finished folder its name; what had it before goes only after that, and after the disk has all of the new one.
        At no moment is there none of that name, where the file system can exchange two. Closes the folder."""
        for path in self.path.iterdir():
            synced(path)
        (self.path / LOG).unlink()
        _entries_synced(self.path)
        old = self.target.with_name(f".{self.target.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        try:
            if not self.target.exists():
                self.path.rename(self.target)
            elif self._exchanged():
                self.path.rename(old)
            else:
                self._swapped(old)
        finally:
            self.close()
        _entries_synced(self.target.parent)
        shutil.rmtree(old, ignore_errors=True)

    def _exchanged(self) -> bool:
        """Whether the folder and what had its name have changed places. That is held as well: it is no work left behind."""
        before = os.open(self.target, os.O_RDONLY | os.O_DIRECTORY)
        self._held.callback(os.close, before)
        with suppress(OSError):
            fcntl.flock(before, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return exchange(self.path, self.target)

    def _swapped(self, old: Path) -> None:
        self.target.rename(old)
        try:
            self.path.rename(self.target)
        except OSError:
            with suppress(OSError):
                old.rename(self.target)
            raise

    def remove(self) -> None:
        """Leave nothing behind, for work that cannot be gone on with."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.close()

    def close(self) -> None:
        """Let go of the folder; the work can be gone on with."""
        self._held.close()

    def _lock(self, descriptor: int) -> None:
        """Raises MapError where another process holds what is open, or has given the folder its name meanwhile."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = _is_of(descriptor, self.path) or _is_of(descriptor, self.path / LOG)
        except BlockingIOError:
            is_free = False
        except OSError:
            return  # a file system without locks
        if not is_free:
            raise MapError("another process is at work on it", where=str(self.target), remedy="wait until it is done, or end it")

    def _read(self, key: str) -> dict[str, Any]:
        """The finished parts; empty where the log is of other work. A line that was broken off ends the log."""
        self._log.seek(0)
        done: dict[str, Any] = {}
        whole = 0
        for line in self._log:
            try:
                entry = json.loads(line) if line.endswith("\n") else None
            except ValueError:
                entry = None
            if not isinstance(entry, dict):
                break
            done |= entry
            whole += len(line.encode())
        self._log.truncate(whole)
        return done if done.get("key") == key else {}

    def _start(self, key: str) -> None:
        for path in self.path.iterdir():
            if path.name == LOG:
                continue
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._log.truncate(0)
        self.record("key", key)
        self.sync()


def _size(n_bytes: float) -> str:
    """Bytes in words that tell small ones apart, too."""
    return f"{n_bytes / 1e9:.2f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.1f} MB"


def exchange(one: Path, other: Path) -> bool:
    """Exchange the names of two folders at one stroke (renameat2(2)); False where the system or the file system cannot."""
    call = getattr(_libc, "renameat2", None)
    names = _AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other)
    return call is not None and call(*names, _RENAME_EXCHANGE) == 0


def _is_of(descriptor: int, path: Path) -> bool:
    """Whether a descriptor is of what now has a name."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


def _closed(log: IO[str]) -> None:
    """Closing writes what is left, which a full disk refuses again: that was told already."""
    with suppress(OSError):
        log.close()


def synced(path: Path) -> None:
    """Hand a file's data to the disk."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def _entries_synced(folder: Path) -> None:
    """Hand the names in a folder to the disk, where its file system can do that for folders."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserved(path: Path) -> None:
    """Have the disk give a file all the blocks that its size stands for: where none is left, a write through a memory map ends
    the process (SIGBUS) instead of raising. Raises OSError."""
    with path.open("r+b") as stream:
        os.posix_fallocate(stream.fileno(), 0, path.stat().st_size)


def work_key(kind: str, software: str, made_from: Sequence[object]) -> str:
    """What a piece of work is made from, as a digest: only work with the same one is gone on with."""
    return hashlib.sha256(json.dumps([kind, software, *made_from]).encode()).hexdigest()


def stage(report: Progress, name: str, total: int) -> Callable[[int], None]:
    """Reports a stage: call with the number of pixels that are done."""
    done = 0

    def step(pixels: int) -> None:
        nonlocal done
        done += pixels
        report(name, min(1.0, done / max(1, total)))

    return step
