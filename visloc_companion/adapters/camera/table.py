"""Times of recorded frames: `frames.csv` with the columns `t_us` and `file`, and whose clock they are of."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

from visloc_companion.errors import CameraError

_REMEDY = "write UTF-8 CSV with the columns t_us (whole microseconds, increasing) and file"


def read_table(path: Path, files: bool) -> list[tuple[int, str]]:
    """Rows (t_us, file) in time order; `files` asks for file names. Raises CameraError naming row and column."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as opened:
            rows = list(csv.DictReader(opened, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as why:
        raise CameraError(f"cannot be read: {why}", where=str(path), remedy=_REMEDY) from why
    found: list[tuple[int, str]] = []
    for number, row in enumerate(rows, start=1):
        clean = {str(key).strip(): value for key, value in row.items()}
        try:
            t_us = int(str(clean["t_us"]).strip())
        except (KeyError, ValueError) as why:
            raise CameraError(
                "holds no whole number of microseconds", where=f"{path}, row {number}, column t_us", remedy=_REMEDY
            ) from why
        name = str(clean.get("file") or "").strip()
        if files and not name:
            raise CameraError("names no file", where=f"{path}, row {number}, column file", remedy=_REMEDY)
        found.append((t_us, name))
    if not found:
        raise CameraError("has no rows", where=str(path), remedy=_REMEDY)
    return sorted(found)


def stamped_by_autopilot(folder: Path) -> bool:
    """Whether `camera.toml` beside the frames says `time_base = "autopilot_boot"`. Raises CameraError for a damaged file."""
    path = folder / "camera.toml"
    if not path.exists():
        return False
    try:
        settings = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as why:
        raise CameraError(f"cannot be read: {why}", where=str(path), remedy="correct the TOML file") from why
    return settings.get("time_base") == "autopilot_boot"
