"""Small files that are whole at any moment: whoever reads one finds the old content or the new, however the writer ended.

Results and reports are written by `write_result`, what programs keep for themselves by `write_whole`.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

_LINKS = 40
"""As many as Linux follows."""


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
    content. What is no file (/dev/null, a pipe) takes it as it comes, and so does a file in a folder that is not to be written
    to, or one that this process has open and that is named as such (/dev/stdout), after what is in it. Raises OSError."""
    number = _open_here(path)
    target = path.resolve()
    if number is not None:
        sys.stdout.flush()  # what was said before comes before it
        with os.fdopen(os.dup(number), "wb") as out:
            out.write(content)
    elif target.exists() and not (target.is_file() and os.access(target.parent, os.W_OK | os.X_OK)):
        path.write_bytes(content)
    else:
        write_whole(target, content, synced=True)


def is_stream(path: Path) -> bool:
    """Whether what is written to a path goes somewhere, and nothing can lie beside it: /dev/stdout, a pipe."""
    return _open_here(path) is not None or (path.exists() and not path.is_file())


def _open_here(path: Path) -> int | None:
    """The number of the open file of this process that a path names, as /dev/stdout and /dev/fd/3 do; None for any other."""
    own = f"/proc/{os.getpid()}/fd"
    for _ in range(_LINKS):
        parent = os.path.realpath(path.parent)
        if parent == own and path.name.isdecimal():
            return int(path.name)
        if not path.is_symlink():
            return None
        path = Path(parent, path.readlink())
    return None
