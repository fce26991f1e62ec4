"""JPEGs that lost data on the way: what follows the gap is shown elsewhere, and localises there."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.unit.adapters.test_camera_device import FakeCapture
from tests.unit.adapters.test_camera_sources import MODEL, JumpingClock, Slots, picture
from visloc_companion.adapters.camera import device
from visloc_companion.adapters.camera.device import DeviceCamera
from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.errors import CameraError
from visloc_companion.types import FrameRef, Image


def ground(height: int = 240, width: int = 320, seed: int = 1) -> Image:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(20, 235, (height // 8, width // 8, 3), np.uint8)
    fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) + rng.normal(0, 6, (height, width, 3))
    return np.asarray(np.clip(fine, 0, 255), dtype=np.uint8)


def jpeg_of(pixels: Image) -> bytes:
    return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 80])[1])


def with_gap(jpeg: bytes, at: float, n_bytes: int) -> bytes:
    start = round(at * len(jpeg))
    return jpeg[:start] + jpeg[start + n_bytes :]


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("at", [0.1, 0.5, 0.8])
def test_a_jpeg_with_a_gap_is_no_image(at: float, grey: bool) -> None:
    pixels = ground()[:, :, 0] if grey else ground()
    whole = jpeg_of(np.ascontiguousarray(pixels))
    assert decode_image(whole) is not None
    assert decode_image(with_gap(whole, at, 900), keep_grey=grey) is None


@pytest.mark.parametrize(("height", "width"), [(240, 320), (363, 517), (241, 321)])
def test_a_whole_jpeg_is_one_whatever_its_corner_shows(height: int, width: int) -> None:
    pixels = ground(height, width)
    for tone in (0, 16, 127, 129, 255):
        pixels[-64:, -64:] = tone
        assert decode_image(jpeg_of(pixels)) is not None
    pixels[-64:, -64:] = 128
    kept = decode_image(bytes(cv2.imencode(".png", pixels)[1]))
    assert kept is not None, "what is no JPEG has nothing filled in"


def in_part() -> Image:
    """What OpenCV gives of a camera's JPEG that lost its end."""
    pixels = picture(9)
    pixels[24:] = 128
    return pixels


async def test_a_device_gives_no_frame_that_came_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "MAX_DAMAGED", 4)
    frames = [picture(1), in_part(), in_part(), picture(2), *(in_part() for _ in range(4)), picture(3)]
    camera, seen = DeviceCamera("0", MODEL, JumpingClock(), capture=FakeCapture([*frames])), list[FrameRef]()
    with pytest.raises(CameraError, match=r"0: gives frames that are half decoded; remedy: check cable and connector"):
        async for frame in camera.frames(Slots()):
            seen.append(frame)
    assert [frame.frame_id for frame in seen] == [1, 4], "numbered through, for the frames' clock"
    assert camera.damaged == 5
