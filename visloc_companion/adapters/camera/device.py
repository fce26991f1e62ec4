"""A camera of this machine through OpenCV (`device:/dev/video0`, `device:0`, or a GStreamer or RTSP address)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, Protocol

import cv2
import numpy as np

from visloc_companion.adapters.camera.after_stall import WAITED, AfterStall
from visloc_companion.adapters.camera.held import held_by
from visloc_companion.adapters.camera.image import HALF_DECODED, is_half_decoded, require_size, rgb, stored
from visloc_companion.adapters.camera.motion_jpeg import MotionJpeg, with_own_sizes
from visloc_companion.errors import CameraError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import CameraModel, FrameRef, Image

MAX_FAILED_READS, MAX_DAMAGED = 5, 50
"""So many one after another, and the camera is given up."""
RELEASE_PATIENCE_S = 1.0


class Capture(Protocol):
    """What is used of cv2.VideoCapture."""

    def read(self) -> tuple[bool, Any]:
        """The next frame (blocks until there is one)."""

    def release(self) -> None:
        """Give the device back."""


class DeviceCamera:
    """Frames are stamped on arrival less `latency_s` (mid-exposure to arrival, which the driver does not tell). Those that waited
    while the camera stalled are left out and counted in `waited`, those whose JPEG came in part in `damaged`.

    `capture` replaces the device in tests. Raises CameraError where the device cannot be opened.
    """

    def __init__(
        self, address: str, model: CameraModel, clock: Clock, latency_s: float = 0.0, capture: Capture | None = None
    ) -> None:
        self._address, self._model, self._clock = address, model, clock
        self._latency_ns = round(latency_s * 1e9)
        self._capture = _opened(address, model) if capture is None else capture
        self._reading: asyncio.Future[tuple[bool, Any]] | None = None
        self._closed = False
        self.waited = self.damaged = 0

    def model(self) -> CameraModel:
        """The configured calibration."""
        return self._model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """Frames as the device gives them, read in a thread.

        Raises CameraError when it gives none several times running, or many in part only, or one of another size than the
        calibration's.
        """
        frame_id, failed, in_part, after_stall = 0, 0, 0, AfterStall()
        while True:
            pixels = await self._read()
            now_ns = self._clock.now_ns()
            if self._closed:
                return
            if pixels is None:
                failed += 1
                if failed >= MAX_FAILED_READS:
                    _require_free(self._address)
                    raise CameraError(
                        "gives no frames", where=self._address, remedy="check the cable and that nothing else uses it"
                    )
                continue
            frame_id, failed = frame_id + 1, 0
            require_size(pixels.shape[1], pixels.shape[0], self._model, self._address)
            fresh = after_stall.is_fresh(now_ns)
            in_part = in_part + 1 if is_half_decoded(pixels) else 0
            if in_part >= MAX_DAMAGED:
                remedy = (
                    "check cable and connector, or lower the camera's rate or its JPEG quality: the line is too slow for them"
                )
                raise CameraError("gives frames that are half decoded", where=self._address, remedy=remedy)
            if in_part:
                self.damaged += 1
            elif fresh:
                yield stored(slots, pixels, frame_id, now_ns, now_ns - self._latency_ns)
            else:
                self.waited += 1

    def left_out(self) -> dict[str, int]:
        """See protocols.Camera."""
        return {WAITED: self.waited, HALF_DECODED: self.damaged}

    async def _read(self) -> Image | None:
        self._reading = asyncio.get_running_loop().run_in_executor(None, self._capture.read)
        try:
            ok, pixels = await asyncio.shield(self._reading)  # who gives up waiting does not end what the thread does
        except cv2.error:  # as of a JPEG without a byte, from a plug that comes loose
            return None
        return rgb(np.asarray(pixels)) if ok and pixels is not None else None

    async def close(self) -> None:
        """Stop, and release the device once the read in progress is over, also where that outlasts this call: a device that is
        held cannot be opened again, and one that is released while it is read takes the process with it."""
        self._closed = True
        if self._reading is None:
            self._capture.release()
            return
        await asyncio.wait({self._reading}, timeout=RELEASE_PATIENCE_S)
        if self._reading.done():
            self._release(self._reading)
        else:
            self._reading.add_done_callback(self._release)

    def _release(self, read: asyncio.Future[tuple[bool, Any]]) -> None:
        if not read.cancelled():
            read.exception()  # nobody else asks for it
        self._capture.release()


def _require_free(address: str, why: Exception | None = None) -> None:
    """Raise CameraError where other processes hold the device, which gives its frames to one."""
    if who := held_by(address):
        raise CameraError(
            f"is used by another program: process {who}",
            where=address,
            remedy="end it (the daemon: systemctl stop visloc), or name another camera",
        ) from why


def _opened(address: str, model: CameraModel) -> Capture:
    source = int(address) if address.isdecimal() else address
    why: cv2.error | None = None
    try:
        capture = cv2.VideoCapture(source)
        if capture.isOpened():
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, model.width_px)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, model.height_px)
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            opened = with_own_sizes(capture, address)
            if isinstance(opened, MotionJpeg) or opened.isOpened():
                return opened
    except cv2.error as fault:
        why = fault
    _require_free(address, why)
    raise CameraError(
        "cannot be opened",
        where=address,
        remedy="check the name (ls /dev/v4l/by-id /dev/video*; those of by-id stay when cameras are plugged in anew), the "
        "right to use it (group video), and that nothing else uses it (sudo fuser -v /dev/video*)",
    ) from why
