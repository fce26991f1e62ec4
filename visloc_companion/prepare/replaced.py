"""The folder that a new pack replaces, and where it lies."""

from __future__ import annotations

import json
import os
import re
from contextlib import suppress
from pathlib import Path

from visloc_companion.errors import MapError
from visloc_companion.maps.manifest import DIGEST, MANIFEST, is_manifest
from visloc_companion.maps.signature import SIGNATURE, SIGNATURE_DRAFT

MOUNTS = Path("/proc/self/mountinfo")


def check_target(folder: Path) -> None:
    """Raise MapError where a folder is something else than a pack (of any version, whole or not), or holds more than one, and for
    a mount point, which nothing can take the place of.

    An empty folder, and one that is not there, are fit.
    """
    if folder.is_dir() and _is_mount_point(folder.resolve()):
        raise MapError(
            "is a mount point, and a new pack takes the place of its folder", where=str(folder), remedy="name a folder in it"
        )
    try:
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return
        is_pack = is_manifest(folder / MANIFEST)
        foreign = _foreign_files(folder) if is_pack else []
    except OSError as why:
        raise MapError(f"cannot be read: {why.strerror}", where=str(folder), remedy="name a folder that can be read") from why
    if not is_pack:
        raise MapError(
            "exists and is no map pack", where=str(folder), remedy="name a folder that does not exist yet, or remove it"
        )
    if foreign:
        raise MapError(
            f"holds {foreign[0]!r}, which is no part of the pack and would be lost",
            where=str(folder),
            remedy="move it out of the folder, or name another folder",
        )


def existing_parent(folder: Path) -> Path:
    """The folder that a folder (links followed) lies in or, where that is still to be made, will lie in."""
    return next(parent for parent in folder.resolve().parents if parent.is_dir())


def _is_mount_point(folder: Path) -> bool:
    """Whether something is mounted there, also a part of the same disk (`mount --bind`), which os.path.ismount does not see."""
    if os.path.ismount(folder):
        return True
    with suppress(OSError):
        lines = MOUNTS.read_bytes().splitlines()
        return any(re.sub(rb"\\([0-7]{3})", _unescaped, line.split(b" ")[4]) == os.fsencode(folder) for line in lines)
    return False


def _unescaped(octal: re.Match[bytes]) -> bytes:
    """The character that mountinfo writes as a backslash and three octal digits (proc_pid_mountinfo(5))."""
    return bytes([int(octal[1], 8)])


def _foreign_files(folder: Path) -> list[str]:
    """Names of what lies in the folder of a pack of any version without being part of it."""
    listed = json.loads((folder / MANIFEST).read_bytes()).get("files")
    own = {MANIFEST, DIGEST, SIGNATURE, SIGNATURE_DRAFT, *(listed if isinstance(listed, dict) else ())}
    return sorted(path.name for path in folder.iterdir() if path.name not in own)
