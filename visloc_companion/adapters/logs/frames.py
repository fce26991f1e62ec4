"""Frames of a recorded flight: image files that frames.csv lists, or a video."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.adapters.camera.motion_jpeg import require_one_size
from visloc_companion.adapters.camera.table import files_listed, require_name, times_of_video
from visloc_companion.adapters.camera.video_stamps import VIDEO_SUFFIXES
from visloc_companion.adapters.logs.video import VideoFrames, notes_on_video, own_times_us
from visloc_companion.errors import LogError
from visloc_companion.types import Image

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".dng", ".bmp", ".webp")


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


def files_named(folder: Path, stem: str, suffixes: Collection[str]) -> list[Path]:
    """The files of a folder with this name and one of these suffixes, both in letters of any size; by name."""
    return sorted(path for path in folder.iterdir() if path.stem.lower() == stem and path.suffix.lower() in suffixes)


def open_frames(folder: Path, start_us: int | None) -> FrameSource | None:
    """The frames of a flight's folder, or None where it has none.

    `frames.csv` has the columns `t_us` and `file` (paths relative to the folder); beside a video it needs `t_us` only, one row a
    frame. A video without frames.csv is timed by its own stamps from `start_us`. Raises LogError for what is missing, wrong or
    there twice.
    """
    table = folder / "frames.csv"
    require_name(table, LogError)
    videos = files_named(folder, "video", VIDEO_SUFFIXES)
    if len(videos) > 1:
        names = ", ".join(path.name for path in videos)
        raise LogError(f"may hold one video, has {names}", where=str(folder), remedy="leave that of the flight there")
    if videos:
        require_one_size(videos[0], LogError)
        times = times_of_video(table, videos[0], LogError) if table.exists() else own_times_us(videos[0], start_us)
        return VideoFrames(videos[0], times)
    if not table.exists():
        return None
    rows = files_listed(table, LogError)
    return FileFrames(tuple(row[0] for row in rows), tuple(folder / row[1] for row in rows))


def notes_on(frames: FrameSource | None, table: Path) -> list[str]:
    """Sentences on what of the frames is of no use. Raises LogError where not one of the files that `table` lists is there."""
    if isinstance(frames, VideoFrames):
        return notes_on_video(frames)
    if frames is None:
        return _passed_over(table)
    files = frames.files if isinstance(frames, FileFrames) else ()
    missing = [file for file in files if not file.is_file()]
    if not missing:
        return []
    if len(missing) == len(files):
        what = f"none of the files that it lists is there, the first being {missing[0]}"
        raise LogError(what, where=str(table), remedy="write paths relative to the folder, with /")
    return [f"Of {len(files)} files of frames.csv, {len(missing)} are not there, the first being {missing[0]}."]


def _passed_over(table: Path) -> list[str]:
    """Sentences on files of a flight's folder, or of a folder in it, that look like frames and are not named as such."""
    found: list[Path] = []
    for folder in (table.parent, *sorted(path for path in table.parent.iterdir() if path.is_dir())):
        with suppress(OSError):
            found += sorted(path.relative_to(table.parent) for path in folder.iterdir() if path.is_file())
    videos = [path for path in found if path.suffix.lower() in VIDEO_SUFFIXES]
    images = [path for path in found if path.suffix.lower() in IMAGE_SUFFIXES]
    notes = [f"{path} was not read: name it video{path.suffix.lower()}, in the flight's folder." for path in videos[:1]]
    if len(images) > 1:  # one may be a mask
        when = f"list them in {table.name} with the time of each (columns t_us,file)"
        notes.append(f"{len(images)} images, the first being {images[0]}, were not read: {when}.")
    return notes
