"""The file with the key of MAVLink signing: read with care for who else could, and made by `visloc link-key`."""

from __future__ import annotations

import hashlib
import re
import secrets
from pathlib import Path

from visloc_companion.adapters.mavlink.signing import KEY_BYTES
from visloc_companion.errors import ConfigError
from visloc_companion.private_file import create_file, read_private

_HEX = re.compile(rf"[0-9a-fA-F]{{{2 * KEY_BYTES}}}")
_MAX_BYTES = 4096
_PASSPHRASE_BYTES = 32


def read_key(path: Path, field: str = "link.signing_key_file") -> bytes:
    """The 32 bytes of a key file: 64 hexadecimal digits, or a passphrase, of which the key is the SHA-256.

    Mission Planner, MAVProxy and QGroundControl make the key of a passphrase in the same way. Raises ConfigError where the file
    cannot be read, belongs to somebody else, may be read or written by others, or holds no key.
    """
    where = f"{field} = {path}"
    return key_of(read_private(path, where, "visloc link-key", _MAX_BYTES + 1), where)


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
    create_file(path, f"{passphrase}\n".encode("ascii"))
    return passphrase
