"""The end of a journal that can no longer be written."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import BinaryIO


def abandon(stream: BinaryIO, path: Path | None) -> None:
    """Close a file whose buffer can no longer be written, and remove the one at `path` where nothing came into it: as the newest
    it would stay in place of the journal of the flight before."""
    with contextlib.suppress(OSError, ValueError):
        getattr(stream, "raw", stream).close()
    with contextlib.suppress(OSError):
        if path is not None and not path.stat().st_size:
            path.unlink()
