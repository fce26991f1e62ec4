"""A camera whose frames a test makes up."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass

from visloc_companion.errors import CameraError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import CameraModel, FrameRef, Image


@dataclass(slots=True)
class FakeCamera:
    """Delivers each of `shots` (time of mid-exposure on the shell's clock, pixels) `latency_ns` after its time.

    With `breaks` it raises CameraError after the last; otherwise the frames simply end.
    """

    camera_model: CameraModel
    shots: Sequence[tuple[int, Image]]
    clock: Clock
    latency_ns: int = 50_000_000
    breaks: bool = False
    closed: bool = False

    def model(self) -> CameraModel:
        """The calibrated model."""
        return self.camera_model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """The shots, in their own time, until `close`."""
        for frame_id, (t_ns, pixels) in enumerate(self.shots):
            await self.clock.sleep_until(t_ns + self.latency_ns)
            if self.closed:
                return
            height_px, width_px = pixels.shape[:2]
            channels = 1 if pixels.ndim == 2 else pixels.shape[2]
            yield FrameRef(self.clock.now_ns(), t_ns, frame_id, slots.write(pixels), width_px, height_px, channels)
        if self.breaks:
            raise CameraError("the camera is gone", where="fake camera", remedy="plug it in again")

    def left_out(self) -> dict[str, int]:
        """None of its frames is."""
        return {}

    async def close(self) -> None:
        """Deliver no more frames."""
        self.closed = True
