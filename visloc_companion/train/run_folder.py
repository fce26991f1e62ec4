"""The folder of a training run: made where it is missing, and held by one process at a time."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from visloc_companion.errors import ConfigError
from visloc_companion.train.checkpoint import FREE_SPACE


@contextmanager
def run_folder(out: Path) -> Iterator[None]:
    """Hold the folder until the block ends or the process does, however it does.

    Raises ConfigError where it cannot be made, or another process trains into it: both would write the same checkpoint and log.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(out, os.O_RDONLY)
    except OSError as why:
        raise ConfigError(f"cannot be made: {why.strerror}", where=str(out), remedy=FREE_SPACE) from why
    try:
        _hold(descriptor, out)
        yield
    finally:
        os.close(descriptor)


def _hold(descriptor: int, out: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as why:
        remedy = "wait until it has ended or break it off, or name another folder for --out"
        raise ConfigError("another process is training into it", where=str(out), remedy=remedy) from why
    except OSError:
        return  # file systems without locks
