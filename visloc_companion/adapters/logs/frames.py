"""Frames of a recorded flight: image files that frames.csv lists, or a video."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import decode_image
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
    frame. A video without frames.csv is timed by its frame rate from `start_us`. Raises LogError for what is missing or wrong.
    """
    table = folder / "frames.csv"
    video = next((path for path in sorted(folder.glob("video.*")) if path.suffix.lower() in VIDEO_SUFFIXES), None)
    rows = _rows(table) if table.exists() else None
    if video is not None:
        return VideoFrames(video, tuple(row[0] for row in rows) if rows else _regular_times(video, start_us))
    if rows is None:
        return None
    for number, (_, name) in enumerate(rows):
        if not name:
            raise LogError(
                "has no file name", where=f"{table}, row {number + 1}, column file", remedy="name the image of each row"
            )
    rows.sort(key=lambda row: row[0])
    return FileFrames(tuple(row[0] for row in rows), tuple(folder / row[1] for row in rows))


def _rows(table: Path) -> list[tuple[int, str]]:
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as why:
        raise LogError(f"cannot be read: {why}", where=str(table), remedy="write UTF-8 CSV with columns t_us, file") from why
    found: list[tuple[int, str]] = []
    for number, row in enumerate(rows):
        clean = {str(key).strip(): value for key, value in row.items()}
        try:
            found.append((int(float(clean["t_us"])), str(clean.get("file") or "").strip()))
        except (KeyError, TypeError, ValueError, OverflowError) as why:
            raise LogError(
                "has no whole number of microseconds",
                where=f"{table}, row {number + 1}, column t_us",
                remedy="write columns t_us, file",
            ) from why
    if not found:
        raise LogError("has no rows", where=str(table), remedy="list the frames as t_us, file")
    return found


def _regular_times(video: Path, start_us: int | None) -> tuple[int, ...]:
    if start_us is None:
        raise LogError(
            "the video's start is unknown",
            where=str(video),
            remedy="set video_start_us in camera.toml, or add frames.csv with a t_us for each frame",
        )
    capture = cv2.VideoCapture(str(video))
    rate, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    if not rate > 0 or count <= 0:
        raise LogError("cannot be decoded as a video", where=str(video), remedy="convert it to MP4 with H.264")
    return tuple(start_us + round(number * 1e6 / rate) for number in range(count))


def _rgb(pixels: Any) -> Image | None:
    return None if pixels is None else np.ascontiguousarray(pixels[:, :, ::-1])
