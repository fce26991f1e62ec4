"""Whether the files of a pack are those that its manifest names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from visloc_companion.errors import HashMismatch, MapError
from visloc_companion.maps.manifest import REBUILD, FileEntry, Manifest, sha256_file


def verify_files(
    folder: Path, manifest: Manifest, *, hashes: bool = True, progress: Callable[[str, int], None] | None = None
) -> None:
    """Check presence, size and (unless `hashes` is False) SHA-256 of every file; stops at the first that is wrong.

    `progress` is called with the name and size of each file after it was checked. Raises MapError, HashMismatch.
    """
    for name, entry in manifest.files.items():
        verify_file(folder / name, entry, hashes=hashes)
        if progress is not None:
            progress(name, entry.bytes)


def verify_file(path: Path, entry: FileEntry, *, hashes: bool = True) -> None:
    """Check one file. Raises MapError where it is missing, HashMismatch where it is another one."""
    if not path.is_file():
        raise MapError("the pack lacks this file", where=str(path), remedy=REBUILD)
    size = path.stat().st_size
    if size != entry.bytes:
        raise HashMismatch(f"has {size} bytes, the manifest says {entry.bytes}", where=str(path), remedy=REBUILD)
    if hashes and sha256_file(path) != entry.sha256:
        raise HashMismatch("does not have the SHA-256 that the manifest names", where=str(path), remedy=REBUILD)
