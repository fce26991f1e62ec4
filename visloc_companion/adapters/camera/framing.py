"""Frames on a byte stream, sans-IO: a header of 36 bytes with its own checksum, then the pixels (raw, PNG or JPEG).

Header, little endian: magic `VLCF`, version u8, flags u8 (bit 0: t_us counts from the autopilot's boot), encoding u8 (0 raw,
1 PNG, 2 JPEG), channels u8, t_us u64, width u32, height u32, payload length u32, CRC-32 of the payload, CRC-32 of the header
before it.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from visloc_companion.adapters.camera.image import decode_image
from visloc_companion.errors import CameraError, PictureSizeError
from visloc_companion.types import Image

MAGIC = b"VLCF"
VERSION = 1
_FIELDS = struct.Struct("<4sBBBBQIIII")
_CHECK = struct.Struct("<I")
HEADER_BYTES = _FIELDS.size + _CHECK.size
AUTOPILOT_CLOCK = 1


class Encoding(IntEnum):
    """How the payload holds the pixels."""

    RAW = 0
    PNG = 1
    JPEG = 2


@dataclass(frozen=True, eq=False)
class StreamedFrame:
    """Pixels (H, W) grey or (H, W, 3) RGB uint8 and their time: microseconds of the autopilot's clock, or of the sender's."""

    pixels: Image
    t_us: int
    autopilot_clock: bool = False


@dataclass(frozen=True)
class EncodedFrame:
    """A frame as it came: its header's fields and the payload, whose checksum was right."""

    t_us: int
    autopilot_clock: bool
    encoding: Encoding
    channels: int
    width_px: int
    height_px: int
    payload: bytes

    def decoded(self) -> StreamedFrame | None:
        """The pixels; None where the payload does not hold an image of the stated size."""
        shape = (self.height_px, self.width_px) + (() if self.channels == 1 else (3,))
        if self.encoding is Encoding.RAW:
            if len(self.payload) != int(np.prod(shape, dtype=np.int64)):
                return None
            return StreamedFrame(np.frombuffer(self.payload, np.uint8).reshape(shape), self.t_us, self.autopilot_clock)
        pixels = decode_image(self.payload)
        if pixels is None or pixels.shape[:2] != shape[:2]:
            return None
        return StreamedFrame(pixels if self.channels == 3 else pixels[:, :, 0].copy(), self.t_us, self.autopilot_clock)


def encode_frame(frame: StreamedFrame, encoding: Encoding = Encoding.RAW, jpeg_quality: int = 90) -> bytes:
    """The bytes of a frame. Raises CameraError for pixels that are not (H, W) or (H, W, 3) uint8 or a time below 0."""
    pixels = frame.pixels
    channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or channels not in (1, 3) or not 0 <= frame.t_us < 1 << 64:
        raise CameraError(f"cannot stream {pixels.dtype} pixels of shape {pixels.shape} at t_us {frame.t_us}")
    if encoding is Encoding.RAW:
        payload = np.ascontiguousarray(pixels).tobytes()
    else:
        bgr = pixels if channels == 1 else pixels[:, :, ::-1]
        suffix, settings = (".png", []) if encoding is Encoding.PNG else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
        payload = cv2.imencode(suffix, np.ascontiguousarray(bgr), settings)[1].tobytes()
    flags = AUTOPILOT_CLOCK if frame.autopilot_clock else 0
    size = (pixels.shape[1], pixels.shape[0])
    head = _FIELDS.pack(MAGIC, VERSION, flags, encoding, channels, frame.t_us, *size, len(payload), zlib.crc32(payload))
    return head + _CHECK.pack(zlib.crc32(head)) + payload


class FrameDecoder:
    """Cuts a byte stream into frames. Damaged stretches are skipped up to the next magic and counted in `resyncs`.

    Holds at most a header, a payload of `max_payload_bytes` and what one call feeds.
    """

    def __init__(self, max_payload_bytes: int = 64 << 20) -> None:
        self._buffer = bytearray()
        self._max_payload = max_payload_bytes
        self._in_step = True
        self.resyncs = 0

    @property
    def buffered_bytes(self) -> int:
        """Bytes that wait for more."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[EncodedFrame]:
        """The frames that are complete with these bytes.

        Raises CameraError for a sound header of another version, PictureSizeError for one of a frame larger than can be meant.
        """
        self._buffer += data
        frames: list[EncodedFrame] = []
        while self._seek_magic() and len(self._buffer) >= HEADER_BYTES:
            head = bytes(self._buffer[: _FIELDS.size])
            _, version, flags, encoding, channels, t_us, width, height, length, payload_check = _FIELDS.unpack(head)
            sound = _CHECK.unpack_from(self._buffer, _FIELDS.size)[0] == zlib.crc32(head)
            if sound and version != VERSION:
                raise CameraError(
                    f"the sender speaks version {version} of the frame stream, this is version {VERSION}",
                    remedy="install the same release on both sides",
                )
            if sound and length > self._max_payload:
                raise PictureSizeError(
                    f"a frame of {width}x{height} in {length} bytes is larger than the calibration's could be",
                    remedy="set the camera to the calibrated size, or calibrate at this size and correct section [camera]",
                )
            known = encoding in iter(Encoding) and channels in (1, 3) and width > 0 and height > 0
            if not (sound and known):
                self._lose_step()
                continue
            if len(self._buffer) < HEADER_BYTES + length:
                break
            payload = bytes(self._buffer[HEADER_BYTES : HEADER_BYTES + length])
            if zlib.crc32(payload) != payload_check:
                self._lose_step()
                continue
            del self._buffer[: HEADER_BYTES + length]
            self._in_step = True
            autopilot_clock = bool(flags & AUTOPILOT_CLOCK)
            frames.append(EncodedFrame(t_us, autopilot_clock, Encoding(encoding), channels, width, height, payload))
        return frames

    def _seek_magic(self) -> bool:
        """Drop bytes before the next magic; False while there is none (the last three bytes may begin one)."""
        at = self._buffer.find(MAGIC)
        skipped = at if at >= 0 else max(0, len(self._buffer) - len(MAGIC) + 1)
        if skipped:
            self._count_resync()
        del self._buffer[:skipped]
        return at >= 0

    def _lose_step(self) -> None:
        self._count_resync()
        del self._buffer[:1]

    def _count_resync(self) -> None:
        if self._in_step:
            self.resyncs += 1
        self._in_step = False
