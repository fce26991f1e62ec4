"""The log of a training run: one JSON object a line, flushed as it goes, cut back to the checkpoint when a run is resumed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from visloc_companion.errors import ConfigError
from visloc_companion.train.checkpoint import FREE_SPACE, write_file

Kind = Literal["baseline", "loss", "validation"]


class RunLog:
    """Lines of a run up to a step, in memory and on disk."""

    def __init__(self, path: Path, up_to_step: int) -> None:
        self._path = path
        self.entries = [entry for entry in _read(path) if entry["step"] <= up_to_step] if up_to_step > 0 else []
        write_file(path, "".join(map(_line, self.entries)).encode())

    def add(self, kind: Kind, step: int, **figures: Any) -> None:
        """Append a line. Raises ConfigError where the disk is full."""
        entry = {"kind": kind, "step": step, **figures}
        self.entries.append(entry)
        try:
            with self._path.open("a", encoding="utf-8") as out:
                out.write(_line(entry))
        except OSError as why:
            raise ConfigError(f"cannot be written: {why.strerror}", where=str(self._path), remedy=FREE_SPACE) from why

    def of(self, kind: Kind) -> list[dict[str, Any]]:
        """All lines of a kind, in order."""
        return [entry for entry in self.entries if entry["kind"] == kind]


def _line(entry: dict[str, Any]) -> str:
    return json.dumps(entry, allow_nan=False) + "\n"


def _read(path: Path) -> list[dict[str, Any]]:
    """Whole lines; the last one may have been cut off with the power."""
    if not path.is_file():
        return []
    entries = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict) and isinstance(entry.get("step"), int) and "kind" in entry:
            entries.append(entry)
    return entries
