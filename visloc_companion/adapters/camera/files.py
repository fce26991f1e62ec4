"""A camera that plays a folder of image files at the pace at which they were taken (`files:FOLDER`)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

from visloc_companion.adapters.camera.image import decode_image, require_size, stored
from visloc_companion.adapters.camera.table import files_listed, reached, stamped_by_autopilot
from visloc_companion.errors import CameraError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import CameraModel, FrameRef, Image


class FilesCamera:
    """`folder` holds `frames.csv` (`t_us, file`) and the images it names. The first frame comes at once, the others as timed.

    With `time_base = "autopilot_boot"` in the folder's `camera.toml`, frames carry `t_boot_ns`. Images that are missing or
    damaged are left out and counted in `unreadable`, those of another size among others in `misfits`.
    Raises CameraError for a folder without a usable table.
    """

    def __init__(self, folder: str | Path, model: CameraModel, clock: Clock) -> None:
        self._folder, self._model, self._clock = Path(folder), model, clock
        with reached(self._folder):
            if not self._folder.is_dir():
                raise CameraError("is not a folder", where=str(folder), remedy="name a folder with frames.csv in camera.url")
            self._rows = files_listed(self._folder / "frames.csv")
            self._of_autopilot = stamped_by_autopilot(self._folder)
        self._closed = False
        self.unreadable = self.misfits = 0

    def model(self) -> CameraModel:
        """The configured calibration."""
        return self._model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """Each readable image at its time; ends with the last one.

        Raises CameraError for a first image of another size than the calibration's, and where not a single image can be read: a
        later one must not begin the recording anew.
        """
        start_ns, start_us = self._clock.now_ns(), self._rows[0][0]
        size = (self._model.height_px, self._model.width_px)
        any_fits = False
        for frame_id, (t_us, name) in enumerate(self._rows, start=1):
            t_ns = start_ns + (t_us - start_us) * 1000
            pixels = await asyncio.to_thread(_read, self._folder / name)
            await self._clock.sleep_until(t_ns)
            if self._closed:
                return
            if pixels is None:
                self.unreadable += 1
                continue
            if any_fits and pixels.shape[:2] != size:
                self.misfits += 1
                continue
            require_size(pixels.shape[1], pixels.shape[0], self._model, str(self._folder / name))
            any_fits = True
            yield stored(slots, pixels, frame_id, self._clock.now_ns(), t_ns, t_us * 1000 if self._of_autopilot else None)
        if self.unreadable == len(self._rows):
            raise CameraError(
                f"none of the {len(self._rows)} images can be read", where=str(self._folder), remedy="give PNG or JPEG files"
            )

    def left_out(self) -> dict[str, int]:
        """See protocols.Camera."""
        return {"missing or damaged": self.unreadable, "of another size": self.misfits}

    async def close(self) -> None:
        """Stop before the next frame."""
        self._closed = True


def _read(path: Path) -> Image | None:
    try:
        return decode_image(path.read_bytes())
    except OSError:
        return None
