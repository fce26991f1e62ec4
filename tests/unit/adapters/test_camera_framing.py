"""Frames on a byte stream: exact round trips, any cutting of the stream, damage, and bounds."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion.adapters.camera.framing import (
    HEADER_BYTES,
    MAGIC,
    EncodedFrame,
    Encoding,
    FrameDecoder,
    StreamedFrame,
    encode_frame,
)
from visloc_companion.errors import CameraError


def picture(seed: int, shape: tuple[int, ...] = (12, 17, 3)) -> np.ndarray:
    smooth = cv2.GaussianBlur(np.random.default_rng(seed).normal(120, 200, shape), (0, 0), 2)
    return np.clip(smooth, 0, 255).astype(np.uint8)


def decoded(frames: list[EncodedFrame]) -> list[StreamedFrame]:
    result = [frame.decoded() for frame in frames]
    assert None not in result
    return [frame for frame in result if frame is not None]


@pytest.mark.parametrize("encoding", [Encoding.RAW, Encoding.PNG])
@pytest.mark.parametrize("shape", [(12, 17, 3), (12, 17)])
@pytest.mark.parametrize("autopilot_clock", [True, False])
def test_lossless_encodings_come_back_exactly(encoding: Encoding, shape: tuple[int, ...], autopilot_clock: bool) -> None:
    data = encode_frame(StreamedFrame(picture(1, shape), 1_234_567_890_123, autopilot_clock), encoding)
    (frame,) = decoded(FrameDecoder().feed(data))
    assert np.array_equal(frame.pixels, picture(1, shape))
    assert (frame.t_us, frame.autopilot_clock) == (1_234_567_890_123, autopilot_clock)


def test_jpeg_keeps_the_colours_apart() -> None:
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[:, :, 0] = 200
    (frame,) = decoded(FrameDecoder().feed(encode_frame(StreamedFrame(pixels, 5), Encoding.JPEG)))
    assert frame.pixels.mean((0, 1)) == pytest.approx([200, 0, 0], abs=3)


@settings(max_examples=40)
@given(cuts=st.lists(st.integers(1, 900), min_size=1, max_size=30), seed=st.integers(0, 5))
def test_any_cutting_of_the_stream_gives_the_same_frames(cuts: list[int], seed: int) -> None:
    stream = b"".join(encode_frame(StreamedFrame(picture(seed + k), k)) for k in range(3))
    decoder, frames, at, turn = FrameDecoder(), [], 0, 0
    while at < len(stream):
        frames += decoder.feed(stream[at : at + cuts[turn % len(cuts)]])
        at, turn = at + cuts[turn % len(cuts)], turn + 1
    assert [frame.t_us for frame in frames] == [0, 1, 2]
    assert all(np.array_equal(frame.pixels, picture(seed + k)) for k, frame in enumerate(decoded(frames)))
    assert (decoder.resyncs, decoder.buffered_bytes) == (0, 0)


@settings(max_examples=60)
@given(at=st.integers(0, 640), garbage=st.binary(min_size=1, max_size=40))
def test_after_damage_the_following_frames_come_through(at: int, garbage: bytes) -> None:
    first, second, third = (encode_frame(StreamedFrame(picture(k), k)) for k in range(3))
    damaged = first[:at] + garbage + first[at:]
    decoder = FrameDecoder()
    times = [frame.t_us for frame in decoder.feed(damaged + second + third)]
    assert times[-2:] == [1, 2]
    assert len(times) == 2 or (times[0] == 0 and decoded(FrameDecoder().feed(first)))
    assert decoder.resyncs >= 1


@given(noise=st.binary(max_size=400))
def test_noise_gives_no_frame_and_is_not_hoarded(noise: bytes) -> None:
    decoder = FrameDecoder(max_payload_bytes=1000)
    for _ in range(20):
        assert decoder.feed(noise) == []
        assert decoder.buffered_bytes <= HEADER_BYTES + 1000


def test_every_single_flipped_bit_of_the_header_is_noticed() -> None:
    data = encode_frame(StreamedFrame(picture(3), 77))
    for bit in range(8 * HEADER_BYTES):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        decoder = FrameDecoder()
        assert [frame.t_us for frame in decoder.feed(bytes(broken) + data)] == [77]
        assert decoder.resyncs == 1


def sealed(head: bytes) -> bytes:
    return head + struct.pack("<I", zlib.crc32(head))


def test_another_version_and_a_frame_too_large_are_named() -> None:
    fields = struct.Struct("<4sBBBBQIIII")
    with pytest.raises(CameraError, match="version 2"):
        FrameDecoder().feed(sealed(fields.pack(MAGIC, 2, 0, 0, 3, 0, 4, 4, 48, 0)))
    with pytest.raises(CameraError, match="4000x3000"):
        FrameDecoder(10_000).feed(sealed(fields.pack(MAGIC, 1, 0, 0, 3, 0, 4000, 3000, 36_000_000, 0)))


def test_a_payload_of_another_size_than_its_header_says_is_no_image() -> None:
    png = cv2.imencode(".png", picture(1))[1].tobytes()
    assert EncodedFrame(0, False, Encoding.PNG, 3, 18, 12, png).decoded() is None
    assert EncodedFrame(0, False, Encoding.RAW, 3, 18, 12, b"123").decoded() is None
    assert EncodedFrame(0, False, Encoding.JPEG, 3, 17, 12, png[:40]).decoded() is None


@pytest.mark.parametrize("pixels", [np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.zeros(4, np.uint8)])
def test_only_images_are_streamed(pixels: np.ndarray) -> None:
    with pytest.raises(CameraError, match="cannot stream"):
        encode_frame(StreamedFrame(pixels, 0))
