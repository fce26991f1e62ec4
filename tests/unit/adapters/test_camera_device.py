"""Cameras that OpenCV opens: times, sizes, channels, failures of a read and of opening."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest

from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, Slots, all_of, picture
from visloc_companion.adapters.camera.device import DeviceCamera
from visloc_companion.errors import CameraError
from visloc_companion.types import FrameRef, Image


class FakeCapture:
    def __init__(self, frames: list[Image | None]) -> None:
        self.frames, self.released = frames, False

    def read(self) -> tuple[bool, Image | None]:
        pixels = self.frames.pop(0) if self.frames else None
        return pixels is not None, pixels

    def release(self) -> None:
        self.released = True


async def test_a_device_is_stamped_before_arrival_and_rides_out_single_failures() -> None:
    capture = FakeCapture([picture(1)[:, :, ::-1], None, picture(2)[:, :, ::-1]])
    clock, slots = JumpingClock(), Slots()
    camera = DeviceCamera("0", MODEL, clock, latency_s=0.04, capture=capture)
    seen: list[FrameRef] = []
    with pytest.raises(CameraError, match="gives no frames"):
        async for frame in camera.frames(slots):
            seen.append(frame)
    assert [frame.t_rx_ns - frame.t_ns for frame in seen] == [40_000_000, 40_000_000]
    assert [int(p[0, 0, 0]) for p in slots.pictures] == [1, 2]
    await camera.close()
    assert capture.released


async def test_a_read_that_opencv_refuses_or_that_gives_nothing_is_a_failed_one() -> None:
    """A frame of no bytes, as from a plug that comes loose: the library raises where it decodes it, or gives no picture."""

    class Loose(FakeCapture):
        n = 0

        def read(self) -> tuple[bool, Image | None]:
            self.n += 1
            if self.n == 1:
                cv2.imdecode(np.zeros(0, np.uint8), cv2.IMREAD_COLOR)
            return (True, None) if self.n == 2 else super().read()

    slots = Slots()
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera("0", MODEL, JumpingClock(), capture=Loose([picture(3)[:, :, ::-1]])), slots)
    assert [int(p[0, 0, 0]) for p in slots.pictures] == [3]


async def test_a_device_that_opencv_cannot_set_up_is_one_that_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_source: object) -> object:
        raise cv2.error("of the backend")

    monkeypatch.setattr(cv2, "VideoCapture", fails)
    with pytest.raises(CameraError, match="cannot be opened"):
        DeviceCamera("/dev/video9", MODEL, JumpingClock())


async def test_a_device_of_another_size_is_an_error() -> None:
    camera = DeviceCamera("/dev/video9", MODEL, JumpingClock(), capture=FakeCapture([picture(1, 32, 24)]))
    with pytest.raises(CameraError, match=r"/dev/video9: image is 32x24"):
        await all_of(camera, Slots())


@pytest.mark.parametrize("filler", [0, 255])
async def test_a_device_with_a_fourth_channel_shows_its_colours(filler: int) -> None:
    """BGRx is what GStreamer's converters of most boards give."""
    bgr = picture(7)[:, :, ::-1]
    bgrx = np.dstack([bgr, np.full(bgr.shape[:2], filler, np.uint8)])
    slots = Slots()
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera("0", MODEL, JumpingClock(), capture=FakeCapture([bgrx])), slots)
    assert [np.array_equal(pixels, picture(7)) for pixels in slots.pictures] == [True]


async def test_a_grey_device_may_say_that_it_has_one_channel() -> None:
    grey, slots = np.full((48, 64, 1), 9, np.uint8), Slots()
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera("0", MODEL, JumpingClock(), capture=FakeCapture([grey])), slots)
    assert [pixels.shape for pixels in slots.pictures] == [(48, 64)]


async def test_a_device_of_16_bits_is_stretched() -> None:
    """A thermal camera's counts; their lower 8 bits alone are a picture of another world."""
    ramp = (8000 + 4 * np.arange(48 * 64).reshape(48, 64)).astype(np.uint16)
    slots = Slots()
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera("0", MODEL, JumpingClock(), capture=FakeCapture([cast("Image", ramp)])), slots)
    assert np.all(np.diff(slots.pictures[0].reshape(-1).astype(int)) >= 0)
    assert (slots.pictures[0].min(), slots.pictures[0].max()) == (0, 255)


def test_a_device_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="cannot be opened"):
        DeviceCamera(str(tmp_path / "video9"), MODEL, JumpingClock())


@contextmanager
def held(path: Path) -> Iterator[int]:
    """The number of another process that has a file open."""
    with path.open("rb") as file, subprocess.Popen(["sleep", "60"], stdin=file) as other:
        try:
            yield other.pid
        finally:
            other.kill()


def test_a_device_that_another_program_uses_is_told_with_its_process(tmp_path: Path) -> None:
    """The system says of a busy camera only that it cannot be opened, and the remedy named cable and rights."""
    device = tmp_path / "video9"
    device.write_bytes(b"no video")
    link = tmp_path / "by-id"
    link.symlink_to(device)
    with held(device) as process:
        for name in (device, link):
            told = rf"{name.name}: is used by another program: process {process} \(sleep\); remedy: end it"
            with pytest.raises(CameraError, match=told):
                DeviceCamera(str(name), MODEL, JumpingClock())
    with pytest.raises(CameraError, match=r"cannot be opened.*nothing else uses it"):
        DeviceCamera(str(device), MODEL, JumpingClock())


async def test_a_device_whose_frames_another_program_gets_is_told_so(tmp_path: Path) -> None:
    device = tmp_path / "video9"
    device.touch()
    with held(device) as process, pytest.raises(CameraError, match=rf"is used by another program: process {process} "):
        await all_of(DeviceCamera(str(device), MODEL, JumpingClock(), capture=FakeCapture([])), Slots())
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera(str(device), MODEL, JumpingClock(), capture=FakeCapture([])), Slots())
