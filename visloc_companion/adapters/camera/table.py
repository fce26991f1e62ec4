"""Times of recorded frames, for the daemon and for replays: `frames.csv` with the columns `t_us` and `file`, beside a video
`t_us` alone, and whose clock they are of."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from visloc_companion.adapters.camera.video_stamps import frame_count, not_shown
from visloc_companion.adapters.table import ErrorKind, finer, number_in, read_table, refuse
from visloc_companion.errors import CameraError

TIME_BASES = ("autopilot_boot", "unix", "offset")
_A_ROW_EACH = "write a row for each frame of the video, in its order"


@contextmanager
def reached(path: Path) -> Iterator[None]:
    """Raises CameraError where what is looked for meanwhile lies where this user may not look."""
    try:
        yield
    except OSError as why:
        remedy = "check the name, and that this user may read it and all folders above it (visloc.service sees none under /home)"
        raise CameraError(f"cannot be read: {why.strerror}", where=str(path), remedy=remedy) from why


def require_name(path: Path, kind: ErrorKind = CameraError) -> None:
    """Refuse a folder that has this file under a name in other letters, large for small: it would be passed over in silence.

    Raises an error of `kind` naming both.
    """
    if path.exists() or not path.parent.is_dir():
        return
    if alike := [other for other in sorted(path.parent.iterdir()) if other.name.lower() == path.name.lower()]:
        raise kind("is not read under this name", where=str(alike[0]), remedy=f"name it {path.name}")


def files_listed(table: Path, kind: ErrorKind = CameraError) -> list[tuple[int, str]]:
    """(t_us, file) in time order, what is there twice once. Raises an error of `kind` naming row and column, and for two files of
    one time."""
    require_name(table, kind)
    found: dict[int, tuple[int, str]] = {}
    for number, row in enumerate(read_table(table, ("t_us", "file"), kind), start=1):
        t_us = _time_us(table, number, row, kind)
        if not row["file"]:
            raise refuse(table, number, "file", "has no file name", "name the image of each row", kind)
        first, known = found.setdefault(t_us, (number, row["file"]))
        if known != row["file"]:
            what = f"has the time of row {first} and another file"
            raise refuse(table, number, "t_us", what, f"{finer(row['t_us'])}, and the frames of one camera only", kind)
    return [(t_us, found[t_us][1]) for t_us in sorted(found)]


def times_of_video(table: Path, video: Path, kind: ErrorKind = CameraError) -> tuple[int, ...]:
    """When each frame of a video was taken, microseconds. Raises an error of `kind` for a table that is not of this video: whose
    times do not grow, that has another number of rows than the video frames, or lists image files that are there."""
    rows = read_table(table, ("t_us",), kind)
    times_us: list[int] = []
    for number, row in enumerate(rows, start=1):
        times_us.append(_time_us(table, number, row, kind))
        after_us = times_us[-1] - times_us[-2] if number > 1 else 1
        if after_us < 0:
            raise refuse(table, number, "t_us", "goes back", _A_ROW_EACH, kind)
        if after_us == 0:
            what = f"has the time of row {number - 1}, and each frame one of its own"
            raise refuse(table, number, "t_us", what, f"{finer(row['t_us'])}; {_A_ROW_EACH}", kind)
    named = [row["file"] for row in rows if row.get("file") and row["file"] != video.name]
    if pictures := [name for name in named if (table.parent / name).is_file()]:
        raise kind(
            f"lists {pictures[0]} beside {video.name}",
            where=str(table),
            remedy="leave either the video or the image files, with their table, in the folder",
        )
    n_frames = frame_count(video, len(rows))
    if not n_frames:
        raise kind("cannot be decoded as a video", where=str(video), remedy="convert it to MP4 with H.264")
    if n_frames != len(rows):
        what, remedy = f"has {len(rows)} rows, {video.name} {n_frames} frames", _A_ROW_EACH
        if (n_hidden := not_shown(video, n_frames)) and n_frames < len(rows):  # its rows may be right
            what += f" that can be shown and {n_hidden} behind damage, or that were lost or cut off"
            remedy = f"copy the video again, or cut the table to its first {n_frames} rows where only the end is missing"
        raise kind(what, where=str(table), remedy=remedy)
    return tuple(times_us)


def _time_us(table: Path, number: int, row: dict[str, str], kind: ErrorKind) -> int:
    try:
        return int(number_in(row["t_us"]))
    except (ValueError, OverflowError) as why:
        raise refuse(table, number, "t_us", "has no whole number of microseconds", "write microseconds", kind) from why


def unheaded(settings: dict[str, Any]) -> dict[str, Any]:
    """The keys of a camera.toml. One that stands under [camera], as `visloc calibrate --out` writes it, holds what it would hold
    without; what is said at both places stays as it is, for the caller to refuse."""
    section = settings.get("camera")
    rest = {key: value for key, value in settings.items() if key != "camera"}
    if not isinstance(section, dict) or section.keys() & rest.keys():
        return settings
    return rest | section


def stamped_by_autopilot(folder: Path) -> bool:
    """Whether `camera.toml` beside the frames says `time_base = "autopilot_boot"`.

    Raises CameraError for a damaged file and an unknown base.
    """
    path = folder / "camera.toml"
    require_name(path)
    if not path.exists():
        return False
    try:
        settings = unheaded(tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as why:
        raise CameraError(f"cannot be read: {why}", where=str(path), remedy="correct the TOML file") from why
    base = settings.get("time_base")
    if base is not None and base not in TIME_BASES:
        raise CameraError(f"time_base: {base!r} is unknown", where=str(path), remedy=f"use one of {', '.join(TIME_BASES)}")
    return base == TIME_BASES[0]
