"""A camera that plays a video file at the pace at which it was taken (`video:FILE`)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import as_stored, require_size, rgb, stored
from visloc_companion.adapters.camera.motion_jpeg import require_one_size
from visloc_companion.adapters.camera.table import reached, require_name, stamped_by_autopilot, times_of_video
from visloc_companion.adapters.camera.video_stamps import is_raw
from visloc_companion.errors import CameraError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import CameraModel, FrameRef


class VideoCamera:
    """`path` is a video that OpenCV decodes. Beside it may lie a table of times, one row a frame with the column `t_us`.

    The table is `<name of the video>.csv`, or else `frames.csv`; without one the video's own stamps time the frames, for cameras
    record at a rate that varies with the light, and its frame rate where it has none.
    `camera.toml` counts as for a folder of files. Raises CameraError for a file that cannot be decoded or without times, and for
    a table that is not of it.
    """

    def __init__(self, path: str | Path, model: CameraModel, clock: Clock) -> None:
        self._path, self._model, self._clock = Path(path), model, clock
        self._capture = cv2.VideoCapture()
        with reached(self._path):
            is_file = self._path.is_file()
        if not (is_file and self._capture.open(str(self._path))):
            raise CameraError("cannot be opened as a video", where=str(path), remedy="name a video file, e.g. MP4 with H.264")
        as_stored(self._capture)
        size = [int(self._capture.get(prop)) for prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
        require_size(size[0], size[1], model, str(path))
        require_one_size(self._path, CameraError)
        tables = [self._path.with_suffix(".csv"), self._path.parent / "frames.csv"]
        for candidate in tables:
            require_name(candidate)
        table = next((candidate for candidate in tables if candidate.exists()), None)
        self._t_us = None if table is None else times_of_video(table, self._path)
        self._of_autopilot = self._t_us is not None and stamped_by_autopilot(self._path.parent)
        self._rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS))
        if self._t_us is None and (is_raw(self._path) or not 0 < self._rate_hz < 1e4):
            raise CameraError(
                "states no frame rate", where=str(path), remedy=f"write the frames' times (t_us) to {tables[0].name} beside it"
            )
        self._first_us = 0
        self._closed = False

    def model(self) -> CameraModel:
        """The configured calibration."""
        return self._model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """Each frame at its time; ends with the video, at the latest with the table."""
        start_ns = self._clock.now_ns()
        number, t_us = 0, 0
        while self._t_us is None or number < len(self._t_us):
            ok, pixels = await asyncio.to_thread(self._capture.read)
            if not ok:
                break
            t_us = self._shown_us(number, t_us) if self._t_us is None else self._t_us[number]
            t_ns = start_ns + (t_us - (self._t_us[0] if self._t_us else 0)) * 1000
            await self._clock.sleep_until(t_ns)
            if self._closed:
                break
            number += 1
            t_boot_ns = t_us * 1000 if self._of_autopilot else None
            yield stored(slots, rgb(np.asarray(pixels)), number, self._clock.now_ns(), t_ns, t_boot_ns)
        if number == 0 and not self._closed:
            raise CameraError("holds no frame that can be decoded", where=str(self._path), remedy="convert it to MP4 with H.264")

    def _shown_us(self, number: int, before_us: int) -> int:
        """When the frame that was just read is shown, after the first one; `before_us`: when the one before it was."""
        stamp_us = round(1e3 * self._capture.get(cv2.CAP_PROP_POS_MSEC))
        if number == 0:
            self._first_us = stamp_us
        elif stamp_us - self._first_us <= before_us:
            return before_us + round(1e6 / self._rate_hz)
        return stamp_us - self._first_us

    def left_out(self) -> dict[str, int]:
        """See protocols.Camera."""
        return {}

    async def close(self) -> None:
        """Stop before the next frame and release the file."""
        self._closed = True
        self._capture.release()
