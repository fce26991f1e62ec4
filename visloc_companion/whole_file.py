"""Small files that are whole at any moment: whoever reads one finds the old content or the new, however the writer ended.

Results and reports are written by `write_result`, what programs keep for themselves by `write_whole`.
"""

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


def write_result(path: Path, content: bytes) -> None:
    """Replace a result's content as `write_whole` does, on the disk before it has its name. A link stays and leads to the new
    content. What is no file (/dev/stdout, a pipe) takes it as it comes, and so does a file in a folder that is not to be written
    to. Raises OSError."""
    target = path.resolve()
    if target.exists() and not (target.is_file() and os.access(target.parent, os.W_OK | os.X_OK)):
        path.write_bytes(content)
    else:
        write_whole(target, content, synced=True)
