"""Files that must stay what they are while something is made from them: a pack of two versions of one is of neither."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from visloc_companion.errors import MapError, VislocError


class Unchanged:
    """Size and time of the last change of files, from when it is made. As a context it tells of a change instead of the error
    that came of it."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self._seen = {path: _state(path) for path in paths}

    def require(self) -> None:
        """Raise MapError where a file is not what it was."""
        for path, seen in self._seen.items():
            if _state(path) != seen:
                raise MapError(
                    "has changed while the pack was made from it",
                    where=str(path),
                    remedy="wait until nothing writes it any more (a copy, a download, an export), then give the command again",
                )

    def __enter__(self) -> Self:
        """The files themselves."""
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, trace: TracebackType | None) -> None:
        """After a refusal, look first whether a file has changed."""
        if isinstance(why, VislocError):
            self.require()


def _state(path: Path) -> tuple[int, int] | None:
    """Bytes, and nanoseconds since 1970; None where there is no such file (who reads it says so)."""
    with suppress(OSError):
        there = path.stat()
        return there.st_size, there.st_mtime_ns
    return None
