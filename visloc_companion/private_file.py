"""Files with secrets: read only where nobody else could have, and made so that nobody else may."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from visloc_companion.errors import ConfigError

_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def read_private(path: Path, where: str, made_by: str, max_bytes: int) -> bytes:
    """The first `max_bytes` of a file. `where` and `made_by` (the command that makes such a file) are for messages.

    Raises ConfigError where it cannot be read, is no regular file, belongs to somebody else, or may be read or written by others.
    """
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _demand_privacy(os.fstat(file.fileno()), where, path, made_by)
            return file.read(max_bytes)
    except PermissionError as why:
        remedy = f"run this as the user whose key it is, or make {path} that of the user who runs it (chown, chmod 600)"
        raise ConfigError(f"cannot be read: {why.strerror}", where=where, remedy=remedy) from why
    except OSError as why:
        raise ConfigError(f"cannot be read: {why.strerror}", where=where, remedy=f"make one with `{made_by}`") from why


def create_file(path: Path, content: bytes, mode: int = 0o600) -> None:
    """Make a file that has these rights from the start. Raises ConfigError where it exists already or cannot be made, and where
    nobody else is to use it, on a disk that keeps no rights (FAT)."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    except OSError as why:
        remedy = "name a file that does not exist yet, in a folder that you may write to"
        raise ConfigError(f"cannot be made: {why.strerror}", where=str(path), remedy=remedy) from why
    try:
        with os.fdopen(descriptor, "wb") as file:
            _demand_kept_rights(os.fstat(descriptor), path, mode)
            file.write(content)
    except ConfigError:
        path.unlink(missing_ok=True)
        raise
    except OSError as why:  # a file without a key would stand in the way of the next try
        path.unlink(missing_ok=True)
        raise ConfigError(
            f"cannot be written: {why.strerror}", where=str(path), remedy="make room, or name another disk"
        ) from why


def _demand_kept_rights(status: os.stat_result, path: Path, mode: int) -> None:
    if stat.S_ISREG(status.st_mode) and not mode & _OTHERS and status.st_mode & _OTHERS:
        what = f"others may use it there (mode {stat.S_IMODE(status.st_mode):04o}): that disk keeps no rights (FAT, exFAT)"
        raise ConfigError(what, where=str(path), remedy="name a file on another disk")


def _demand_privacy(status: os.stat_result, where: str, path: Path, made_by: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise ConfigError("is no regular file", where=where, remedy=f"make one with `{made_by}`")
    if status.st_uid != os.geteuid():
        what = f"belongs to user {status.st_uid}, not to the one that visloc runs as ({os.geteuid()})"
        raise ConfigError(what, where=where, remedy=f"chown {os.geteuid()} {path}")
    if status.st_mode & _OTHERS:
        what = f"may be used by others (mode {stat.S_IMODE(status.st_mode):04o})"
        remedy = f"chmod 600 {path} (where that changes nothing, as on FAT, copy it to another disk first)"
        raise ConfigError(what, where=where, remedy=f"{remedy}, and make a new key if others may have read it")
