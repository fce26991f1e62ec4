"""Small files that are whole at any moment: whoever reads one finds the old content or the new, however the writer ended."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: bytes, *, synced: bool = False) -> None:
    """Replace a file's content, by way of a draft `.NAME.part` beside it, of which nothing stays.

    `synced`: the data are on the disk before the file has its name, so that a loss of power leaves no empty one. Raises OSError.
    """
    draft = path.with_name(f".{path.name}.part")
    try:
        with draft.open("wb") as out:
            out.write(content)
            if synced:
                out.flush()
                os.fsync(out.fileno())
        draft.replace(path)
    except OSError:
        with suppress(OSError):
            draft.unlink()
        raise
