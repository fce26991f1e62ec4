from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.evaluate.cases import read_frame

RISING = np.tile(np.arange(0, 200, 2, dtype=np.uint8), (60, 1))
COLOUR_BGR = np.dstack([RISING, RISING // 2, 255 - RISING])


def coded(suffix: str, pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(suffix, pixels)[1])


def turned(jpeg: bytes, orientation: int) -> bytes:
    """A JPEG whose EXIF asks viewers to turn it."""
    tiff = b"II*\0" + struct.pack("<IHHHIII", 8, 1, 0x112, 3, 1, orientation, 0)
    body = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def huge_png() -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 99)) + chunk(b"IEND", b"")


def test_colour_and_grey() -> None:
    colour, grey = decode_image(coded(".png", COLOUR_BGR)), decode_image(coded(".png", RISING), keep_grey=True)
    assert colour is not None and grey is not None
    assert np.array_equal(colour, COLOUR_BGR[:, :, ::-1])
    assert np.array_equal(grey, RISING)
    three = decode_image(coded(".png", RISING))
    assert three is not None and three.shape == (60, 100, 3)


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_pixels_are_taken_as_they_are_stored(orientation: int) -> None:
    jpeg = coded(".jpg", COLOUR_BGR)
    plain, marked = decode_image(jpeg), decode_image(turned(jpeg, orientation))
    assert plain is not None and marked is not None
    assert np.array_equal(plain, marked)


@pytest.mark.parametrize(("gain", "base"), [(257, 0), (16, 0), (3, 7000)])
def test_sixteen_bits_are_stretched_to_eight(gain: int, base: int) -> None:
    found = decode_image(coded(".png", base + RISING.astype(np.uint16) * gain), keep_grey=True)
    assert found is not None and found.dtype == np.uint8
    assert found == pytest.approx(RISING * (255 / 198), abs=1.01)
    flat = decode_image(coded(".png", np.full((60, 60), 5000, np.uint16)), keep_grey=True)
    assert flat is not None and not flat.any()


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_that_is_cut_off_is_no_image(progressive: int) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    jpeg = bytes(cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1])
    thumbnail = coded(".jpg", RISING)
    with_thumbnail = jpeg[:2] + b"\xff\xe2" + struct.pack(">H", len(thumbnail) + 2) + thumbnail + jpeg[2:]
    for whole in (jpeg, jpeg + b"\0" * 30, with_thumbnail):
        assert decode_image(whole) is not None
        for share in (0.2, 0.5, 0.97):
            assert decode_image(whole[: int(share * (len(whole) - 30))]) is None


def test_what_cannot_be_decoded_is_no_frame_and_no_error(tmp_path: Path) -> None:
    for number, data in enumerate((b"", b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xe0", b"junk" * 99, huge_png())):
        path = tmp_path / f"{number}.png"
        path.write_bytes(data)
        assert read_frame(path) is None
    assert read_frame(tmp_path / "absent.png") is None
    assert read_frame(tmp_path) is None
