"""Frames of a recorded flight: image files that frames.csv lists, or a video."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.adapters.logs.table import read_table, refuse
from visloc_companion.errors import LogError
from visloc_companion.types import Image

VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")


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


class VideoFrames:
    """A video, decoded forwards; asking for an earlier frame begins anew."""

    def __init__(self, path: Path, t_us: tuple[int, ...]) -> None:
        self.t_us = t_us
        self._path = path
        self._capture: Any = None
        self._next = 0

    def pixels(self, number: int) -> Image | None:
        """The pixels of a frame; None past the end or where it is damaged."""
        if self._capture is None or number < self._next:
            self._capture, self._next = cv2.VideoCapture(str(self._path)), 0
        while self._next < number and self._capture.grab():
            self._next += 1
        if self._next != number:
            return None
        ok, pixels = self._capture.read()
        self._next += 1
        return _rgb(pixels) if ok else None


def open_frames(folder: Path, start_us: int | None) -> FrameSource | None:
    """The frames of a flight's folder, or None where it has none.

    `frames.csv` has the columns `t_us` and `file` (paths relative to the folder); beside a video it needs `t_us` only, one row a
    frame. A video without frames.csv is timed by its own stamps from `start_us`. Raises LogError for what is missing or wrong.
    """
    table = folder / "frames.csv"
    video = next((path for path in sorted(folder.glob("video.*")) if path.suffix.lower() in VIDEO_SUFFIXES), None)
    if video is not None:
        times = tuple(t_us for t_us, _ in _rows(table, files=False)) if table.exists() else _own_times(video, start_us)
        return VideoFrames(video, times)
    if not table.exists():
        return None
    rows = sorted(_rows(table, files=True), key=lambda row: row[0])
    return FileFrames(tuple(row[0] for row in rows), tuple(folder / row[1] for row in rows))


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
        found.append((t_us, "" if not files else row["file"]))
    return found


def _own_times(video: Path, start_us: int | None) -> tuple[int, ...]:
    if start_us is None:
        raise LogError(
            "the video's start is unknown",
            where=str(video),
            remedy="set video_start_us in camera.toml, or add frames.csv with a t_us for each frame",
        )
    shown_us = _stamps_us(video)
    if not shown_us:
        raise LogError("cannot be decoded as a video", where=str(video), remedy="convert it to MP4 with H.264")
    return tuple(start_us + t_us for t_us in shown_us)


def _stamps_us(video: Path) -> list[int]:
    """When each frame is shown after the first, microseconds: cameras and phones record at a rate that varies with the light.

    A video whose frames have no stamps of their own is timed by its rate.
    """
    capture = cv2.VideoCapture(str(video))
    rate_hz, shown_us = capture.get(cv2.CAP_PROP_FPS), []
    while capture.grab():
        shown_us.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e3))
    capture.release()
    if all(before < after for before, after in pairwise(shown_us)):
        return [t_us - shown_us[0] for t_us in shown_us]
    return [round(number * 1e6 / rate_hz) for number in range(len(shown_us))] if rate_hz > 0 else []


def _rgb(pixels: Any) -> Image | None:
    return None if pixels is None else np.ascontiguousarray(pixels[:, :, ::-1])
