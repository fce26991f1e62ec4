"""A video of a recorded flight: its frames, as they are stored, and when each of them is shown."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import as_stored
from visloc_companion.adapters.camera.video_stamps import is_raw, not_shown, stamps_us
from visloc_companion.errors import LogError
from visloc_companion.types import Image

_OFF_PERIODS = 1.5
"""A rate times a video whose stamps are out of order only if none of them is further from it, in periods."""
_STAMP_THEM = "add frames.csv with a t_us for each frame"


class VideoFrames:
    """A video, decoded forwards; asking for an earlier frame begins anew."""

    def __init__(self, path: Path, t_us: tuple[int, ...]) -> None:
        self.t_us = t_us
        self.path = path
        self._capture: Any = None
        self._next = 0

    def pixels(self, number: int) -> Image | None:
        """The pixels of a frame; None past the end or where it is damaged."""
        if self._capture is None or number < self._next:
            self._capture, self._next = as_stored(cv2.VideoCapture(str(self.path))), 0
        while self._next < number and self._capture.grab():
            self._next += 1
        if self._next != number:
            return None
        ok, pixels = self._capture.read()
        self._next += 1
        return _rgb(pixels) if ok else None


def turn_deg(video: Path) -> int:
    """By how many degrees clockwise the file asks viewers to turn its frames."""
    return round(cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_ORIENTATION_META)) % 360


def own_times_us(video: Path, start_us: int | None) -> tuple[int, ...]:
    """When its frames were taken by its own stamps, the first at `start_us`; frames that are shown at once, in a video of no even
    rate, have one time. Raises LogError where neither says."""
    if start_us is None:
        raise LogError(
            "the video's start is unknown",
            where=str(video),
            remedy=f"set video_start_us in camera.toml, or {_STAMP_THEM}",
        )
    shown_us, rate_hz = stamps_us(video)
    if not shown_us:
        raise LogError("cannot be decoded as a video", where=str(video), remedy="convert it to MP4 with H.264")
    if is_raw(video):
        raise LogError("is a bare stream, which holds no times", where=str(video), remedy=_STAMP_THEM)
    if any(before >= after for before, after in pairwise(shown_us)):
        shown_us = _by_rate(video, shown_us, rate_hz)
    return tuple(start_us + t_us - shown_us[0] for t_us in shown_us)


def _by_rate(video: Path, shown_us: list[int], rate_hz: float) -> list[int]:
    """Times by the rate of a video that has no stamps, or whose stamps go back or stand still about it. Elsewhere those of stamps
    that stand still at most; raises LogError where they go back."""
    goes_back = any(before > after for before, after in pairwise(shown_us))
    all_at_once = shown_us[0] == shown_us[-1]
    if not rate_hz > 0 and (goes_back or all_at_once):
        raise LogError("states neither stamps nor a rate", where=str(video), remedy=_STAMP_THEM)
    period_us = 1e6 / rate_hz if rate_hz > 0 else 0.0
    even_us = [shown_us[0] + round(number * period_us) for number in range(len(shown_us))]
    worst_us = max(abs(shown - even) for shown, even in zip(shown_us, even_us, strict=True))
    if all_at_once or worst_us <= _OFF_PERIODS * period_us:
        return even_us
    if goes_back:
        raise LogError("its stamps go back, and it has no even rate", where=str(video), remedy=_STAMP_THEM)
    return shown_us


def notes_on_video(frames: VideoFrames) -> list[str]:
    """Sentences on how its frames are turned, on those that it holds and does not show, and on those that the stamps of the file
    do not tell apart in time."""
    asked_deg = turn_deg(frames.path)
    name = frames.path.name
    notes = (
        [f"{name} asks viewers to turn it by {asked_deg} degrees: its frames were taken as they are stored."] if asked_deg else []
    )
    n_missing = not_shown(frames.path, len(frames.t_us))
    if n_missing:
        holds = f"{name} holds {n_missing + len(frames.t_us)} frames and shows {len(frames.t_us)}, the last at its second"
        last_s = (frames.t_us[-1] - frames.t_us[0]) / 1e6
        why = "it is damaged from there on, lost frames while it was recorded, or was cut without being encoded anew"
        notes.append(f"{holds} {last_s:.1f}: {why}. Copy it again, or convert it (ffmpeg -i {name} NEW.mp4).")
    at_once = [number for number, (before, after) in enumerate(pairwise(frames.t_us), start=1) if before == after]
    if at_once:
        has = "has" if len(at_once) == 1 else "have"
        told = f"Of {len(frames.t_us)} frames of {name}, {len(at_once)} {has} the time of the one before, the first being"
        notes.append(f"{told} frame {at_once[0]} (from 0): {_STAMP_THEM}.")
    return notes


def _rgb(pixels: Any) -> Image | None:
    return None if pixels is None else np.ascontiguousarray(pixels[:, :, ::-1])
