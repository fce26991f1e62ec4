"""Frames of a recorded flight: image files that frames.csv lists, or a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.adapters.logs.table import read_table, refuse
from visloc_companion.adapters.logs.video import VIDEO_SUFFIXES, VideoFrames, frame_count, own_times_us, turn_deg
from visloc_companion.errors import LogError
from visloc_companion.types import Image


class FrameSource(Protocol):
    """Times and pixels of recorded frames, numbered from 0 in time order."""

    @property
    def t_us(self) -> tuple[int, ...]:
        """Time of each frame on the recording's own time base, microseconds, never decreasing."""

    def pixels(self, number: int) -> Image | None:
        """The (H, W, 3) RGB pixels of a frame; None where it cannot be decoded."""


@dataclass(frozen=True, slots=True)
class FileFrames:
    """Image files."""

    t_us: tuple[int, ...]
    files: tuple[Path, ...]

    def pixels(self, number: int) -> Image | None:
        """The pixels of a frame; None for a missing or damaged file."""
        try:
            return decode_image(self.files[number].read_bytes())
        except OSError:
            return None


def open_frames(folder: Path, start_us: int | None) -> FrameSource | None:
    """The frames of a flight's folder, or None where it has none.

    `frames.csv` has the columns `t_us` and `file` (paths relative to the folder); beside a video it needs `t_us` only, one row a
    frame. A video without frames.csv is timed by its own stamps from `start_us`. Raises LogError for what is missing, wrong or
    there twice.
    """
    table = folder / "frames.csv"
    videos = [path for path in sorted(folder.glob("video.*")) if path.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) > 1:
        names = ", ".join(path.name for path in videos)
        raise LogError(f"may hold one video, has {names}", where=str(folder), remedy="leave that of the flight there")
    if videos:
        times = _listed_times(table, videos[0]) if table.exists() else own_times_us(videos[0], start_us)
        return VideoFrames(videos[0], times)
    if not table.exists():
        return None
    rows = sorted(_rows(table, files=True), key=lambda row: row[0])
    return FileFrames(tuple(row[0] for row in rows), tuple(folder / row[1] for row in rows))


def notes_on(frames: FrameSource | None, table: Path) -> list[str]:
    """Sentences on what of the frames is of no use. Raises LogError where not one of the files that `table` lists is there."""
    if isinstance(frames, VideoFrames):
        asked_deg = turn_deg(frames.path)
        asked = f"{frames.path.name} asks viewers to turn it by {asked_deg} degrees: its frames were taken as they are stored."
        return [asked] if asked_deg else []
    files = frames.files if isinstance(frames, FileFrames) else ()
    missing = [file for file in files if not file.is_file()]
    if not missing:
        return []
    if len(missing) == len(files):
        what = f"none of the files that it lists is there, the first being {missing[0]}"
        raise LogError(what, where=str(table), remedy="write paths relative to the folder, with /")
    return [f"Of {len(files)} files of frames.csv, {len(missing)} are not there, the first being {missing[0]}."]


def _listed_times(table: Path, video: Path) -> tuple[int, ...]:
    rows = _rows(table, files=False)
    pictures = [name for _, name in rows if name and name != video.name and (table.parent / name).is_file()]
    if pictures:
        raise LogError(
            f"lists {pictures[0]} beside {video.name}",
            where=str(table),
            remedy="leave either the video or the image files, with their table, in the folder",
        )
    n_frames = frame_count(video, len(rows))
    if n_frames != len(rows):
        what = f"has {len(rows)} rows, {video.name} {n_frames} frames"
        raise LogError(what, where=str(table), remedy="write a row for each frame of the video, in its order")
    return tuple(t_us for t_us, _ in rows)


def _rows(table: Path, files: bool) -> list[tuple[int, str]]:
    """(t_us, file) as the table lists them; without `files` the column of that name need not be there."""
    found: list[tuple[int, str]] = []
    for number, row in enumerate(read_table(table, ("t_us", "file") if files else ("t_us",)), start=1):
        try:
            t_us = int(float(row["t_us"]))
        except (ValueError, OverflowError) as why:
            raise refuse(table, number, "t_us", "has no whole number of microseconds", "write microseconds") from why
        if files and not row["file"]:
            raise refuse(table, number, "file", "has no file name", "name the image of each row")
        if not files and found and t_us < found[-1][0]:
            raise refuse(table, number, "t_us", "goes back", "write a row for each frame of the video, in its order")
        found.append((t_us, row.get("file", "")))
    return found
