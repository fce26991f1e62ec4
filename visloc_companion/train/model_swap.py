"""A model's folder is made beside the one it replaces: who opens a network finds the old one or the new, never parts of both."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.localise.model_folder import GOLDEN, MANIFEST, VARIANT_FILES, read_manifest
from visloc_companion.prepare.kept_folders import draft_in
from visloc_companion.prepare.work_folder import exchange, synced
from visloc_companion.train.checkpoint import FREE_SPACE
from visloc_companion.train.model_card import CARD
from visloc_companion.whole_file import write_whole


@contextmanager
def replacing(out: Path) -> Iterator[Path]:
    """An empty folder that becomes the model's folder `out` at one stroke in the end; after an error `out` is what it was.

    Where `out` holds other files as well, or cannot change places (a mount point, a folder in one that is not to be written to),
    its files are replaced one by one, the manifest last: broken off there, the hashes of the manifest do not fit. Raises
    ConfigError where it cannot be written.
    """
    target = out.resolve()
    try:
        beside = target if target.is_dir() and not os.access(target.parent, os.W_OK | os.X_OK) else target.parent
        with draft_in(beside, f".{target.name}.export-") as draft:
            yield draft
            for path in draft.iterdir():
                synced(path)
            draft.chmod(target.stat().st_mode if target.is_dir() else _usual_mode())
            _take_place(draft, target)
    except OSError as why:
        raise ConfigError(f"cannot be written: {why.strerror}", where=str(out), remedy=FREE_SPACE) from why


def _take_place(draft: Path, target: Path) -> None:
    if not target.exists():
        draft.rename(target)
    elif _others(target) or not exchange(draft, target):
        if not target.is_dir():
            raise NotADirectoryError(0, "is no folder", str(target))
        for path in sorted(draft.iterdir(), key=lambda path: path.name == MANIFEST):
            write_whole(target / path.name, path.read_bytes(), synced=True)


def _others(folder: Path) -> bool:
    """Whether a folder, or what has its name, holds anything but a model."""
    if not folder.is_dir():
        return True
    own = {*VARIANT_FILES.values(), GOLDEN, MANIFEST, CARD}
    try:
        manifest = read_manifest(folder)
        own |= {entry.file for entry in (*manifest.variants.values(), manifest.golden)}
    except ModelError:
        pass  # broken off, or of another version
    return any(path.name not in own for path in folder.iterdir())


def _usual_mode() -> int:
    """What a new folder gets: mkdtemp's is for its owner alone."""
    mask = os.umask(0)
    os.umask(mask)
    return 0o777 & ~mask
