"""The file with the key of MAVLink signing: read with care for who else could, and made by `visloc link-key`."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import stat
from pathlib import Path

from visloc_companion.adapters.mavlink.signing import KEY_BYTES
from visloc_companion.errors import ConfigError

_HEX = re.compile(rf"[0-9a-fA-F]{{{2 * KEY_BYTES}}}")
_MAX_BYTES = 4096
_PASSPHRASE_BYTES = 32


def read_key(path: Path, field: str = "link.signing_key_file") -> bytes:
    """The 32 bytes of a key file: 64 hexadecimal digits, or a passphrase, of which the key is the SHA-256.

    Mission Planner, MAVProxy and QGroundControl make the key of a passphrase in the same way. Raises ConfigError where the file
    cannot be read, belongs to somebody else, may be read or written by others, or holds no key.
    """
    where = f"{field} = {path}"
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _demand_privacy(os.fstat(file.fileno()), where, path)
            content = file.read(_MAX_BYTES + 1)
    except PermissionError as why:
        remedy = f"run this as the user whose key it is, or make {path} that of the user who runs it (chown, chmod 600)"
        raise ConfigError(f"cannot be read: {why.strerror}", where=where, remedy=remedy) from why
    except OSError as why:
        raise ConfigError(f"cannot be read: {why.strerror}", where=where, remedy="make one with `visloc link-key`") from why
    return key_of(content, where)


def key_of(content: bytes, where: str) -> bytes:
    """The key in the content of a file; line ends behind it are no part of a passphrase. Raises ConfigError."""
    remedy = "write 64 hexadecimal digits or a passphrase on one line, or make one with `visloc link-key`"
    try:
        text = content.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError:
        raise ConfigError("is not text", where=where, remedy=remedy) from None
    if not text.strip() or "\n" in text or len(content) > _MAX_BYTES:
        raise ConfigError("holds no key", where=where, remedy=remedy)
    key = bytes.fromhex(text) if _HEX.fullmatch(text) else hashlib.sha256(text.encode()).digest()
    if not any(key):
        raise ConfigError("is all zero, which switches signing off in ArduPilot", where=where, remedy=remedy)
    return key


def write_key(path: Path) -> str:
    """Make a file with a random passphrase of 256 bits that nobody but its owner may read; the passphrase.

    Raises ConfigError where it exists already or cannot be made.
    """
    passphrase = secrets.token_urlsafe(_PASSPHRASE_BYTES)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as why:
        remedy = "name a file that does not exist yet, in a folder that you may write to"
        raise ConfigError(f"cannot be made: {why.strerror}", where=str(path), remedy=remedy) from why
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(passphrase + "\n")
    except OSError as why:  # a file without a key would stand in the way of the next try
        path.unlink(missing_ok=True)
        raise ConfigError(
            f"cannot be written: {why.strerror}", where=str(path), remedy="make room, or name another disk"
        ) from why
    return passphrase


def _demand_privacy(status: os.stat_result, where: str, path: Path) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise ConfigError("is no regular file", where=where, remedy="make one with `visloc link-key`")
    if status.st_uid != os.geteuid():
        what = f"belongs to user {status.st_uid}, not to the one that visloc runs as ({os.geteuid()})"
        raise ConfigError(what, where=where, remedy=f"chown {os.geteuid()} {path}")
    if status.st_mode & 0o077:
        what = f"may be used by others (mode {stat.S_IMODE(status.st_mode):04o})"
        raise ConfigError(what, where=where, remedy=f"chmod 600 {path}, and make a new key if others may have read it")
