"""Streams of JPEGs whose pictures change their size: FFmpeg stretches them to that of the first, and says nothing."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, Slots, all_of
from visloc_companion.adapters.camera.device import DeviceCamera
from visloc_companion.adapters.camera.motion_jpeg import jpeg_size, require_one_size
from visloc_companion.adapters.camera.video import VideoCamera
from visloc_companion.adapters.logs.frames import open_frames
from visloc_companion.errors import CameraError, LogError, PictureSizeError
from visloc_companion.prepare.lens.pictures import pictures_of

CALIBRATED, ON_ITS_SIDE, LARGER = (64, 48), (48, 64), (128, 72)


def jpeg(size: tuple[int, int], grey: int, settings: Sequence[int] = ()) -> bytes:
    width, height = size
    return cv2.imencode(".jpg", np.full((height, width, 3), grey, np.uint8), list(settings))[1].tobytes()


def stream(path: Path, sizes: Sequence[tuple[int, int]]) -> Path:
    path.write_bytes(b"".join(jpeg(size, 10 * k) for k, size in enumerate(sizes)))
    return path


@pytest.mark.parametrize("other", [ON_ITS_SIDE, LARGER])
async def test_a_camera_that_changes_its_size_is_refused_with_both(tmp_path: Path, other: tuple[int, int]) -> None:
    path, slots = stream(tmp_path / "camera.mjpeg", [CALIBRATED] * 5 + [other] * 5), Slots()
    told = rf"image is {other[0]}x{other[1]}, the calibration is for 64x48; remedy: set the camera to the calibrated size"
    with pytest.raises(PictureSizeError, match=told):
        await all_of(DeviceCamera(str(path), MODEL, JumpingClock()), slots)
    assert [round(float(pixels.mean()), -1) for pixels in slots.pictures] == [0, 10, 20, 30, 40]


async def test_its_pictures_are_those_that_ffmpeg_decodes(tmp_path: Path) -> None:
    """From the first one on, which is read to find out what is in the stream."""
    rng = np.random.default_rng(3)
    writer = cv2.VideoWriter(str(tmp_path / "camera.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, CALIBRATED)
    for _ in range(4):
        writer.write(cv2.cvtColor(cv2.resize(rng.integers(0, 255, (6, 8), np.uint8), CALIBRATED), cv2.COLOR_GRAY2BGR))
    writer.release()
    slots, capture = Slots(), cv2.VideoCapture(str(tmp_path / "camera.avi"))
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera(str(tmp_path / "camera.avi"), MODEL, JumpingClock()), slots)
    assert len(slots.pictures) == 4
    for pixels in slots.pictures:
        assert np.abs(pixels.astype(int) - capture.read()[1][:, :, ::-1].astype(int)).mean() < 2.0


async def test_fields_of_interlaced_pictures_are_left_to_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture of two JPEGs, of half its height each: here one that is said to be twice as high as its JPEG."""
    path, of = stream(tmp_path / "camera.mjpeg", [CALIBRATED] * 3), cv2.VideoCapture
    opened = []

    class Woven:
        def __init__(self, *args: object) -> None:
            opened.append(args)
            self._capture = of(*args)

        def get(self, what: int) -> float:
            return self._capture.get(what) * (2 if what == cv2.CAP_PROP_FRAME_HEIGHT else 1)

        def __getattr__(self, name: str) -> object:
            return getattr(self._capture, name)

    monkeypatch.setattr(cv2, "VideoCapture", Woven)
    slots = Slots()
    with pytest.raises(CameraError, match="gives no frames"):
        await all_of(DeviceCamera(str(path), MODEL, JumpingClock()), slots)
    assert (len(slots.pictures), [len(args) for args in opened]) == (3, [1, 3, 1])


def test_a_recorded_video_of_two_sizes_is_refused_by_flights_replays_and_calibrations(tmp_path: Path) -> None:
    path = stream(tmp_path / "video.mjpeg", [CALIBRATED] * 5 + [ON_ITS_SIDE] * 5)
    table = tmp_path / "frames.csv"
    table.write_text("t_us\n" + "".join(f"{40_000 * k}\n" for k in range(10)), encoding="utf-8")
    told = r"frame 5 \(from 0\) is 48x64, those before are 64x48; remedy: cut the video where the camera changed"
    with pytest.raises(CameraError, match=told):
        VideoCamera(path, MODEL, JumpingClock())
    with pytest.raises(LogError, match=told):
        open_frames(tmp_path, None)
    with pytest.raises(CameraError, match=told):
        list(pictures_of(path, 1))
    require_one_size(stream(path, [CALIBRATED] * 10), LogError)
    assert len(list(pictures_of(path, 1))) == 10


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpegs_size_is_read_without_decoding_it(progressive: int) -> None:
    data = jpeg(LARGER, 7, (cv2.IMWRITE_JPEG_PROGRESSIVE, progressive))
    assert jpeg_size(data) == LARGER
    assert jpeg_size(data[:2] + b"\xff" + data[2:]) == LARGER, "markers may be filled up"
    assert all(jpeg_size(data[:n]) in (None, LARGER) for n in itertools.chain(range(200), range(200, len(data), 7)))
    assert jpeg_size(b"") is jpeg_size(b"\x89PNG\r\n") is None
