"""What all cameras share: decoding images, checking their size against the calibration, and the reference of a stored frame."""

from __future__ import annotations

import zlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import PictureSizeError
from visloc_companion.protocols import FrameSlots
from visloc_companion.types import CameraModel, FrameRef, Image

CHECKED_ROWS = 8
"""Every so many rows count for a frame's checksum: enough for noise to tell two exposures apart, in less than a millisecond."""


_AS_STORED = cv2.IMREAD_IGNORE_ORIENTATION | cv2.IMREAD_ANYDEPTH
"""Calibrations know nothing of the turn that EXIF proposes to viewers."""
_JPEG, _SCAN, _END = b"\xff\xd8", 0xDA, b"\xff\xd9"
HALF_DECODED = "data were lost on the way"
_FILL, _CORNER_PX = 128, 4
"""What a JPEG decoder puts where blocks are missing, and so much of the last one: a lens's rim is black, a sensor has noise."""


def decode_image(data: bytes, *, keep_grey: bool = False) -> Image | None:
    """(H, W, 3) RGB of an image file's bytes, (H, W) of a grey one with `keep_grey`; None where they are damaged or cut off, as
    far as a decoder tells.

    Values of more than 8 bits are stretched between nearly their least and greatest: a thermal camera uses few of them.
    """
    if not data or _is_cut_jpeg(data):
        return None
    flags = (cv2.IMREAD_ANYCOLOR if keep_grey else cv2.IMREAD_COLOR) | _AS_STORED
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
    if pixels is None or (data.startswith(_JPEG) and is_half_decoded(np.asarray(pixels))):
        return None
    return rgb(np.asarray(pixels))


def is_half_decoded(pixels: NDArray[Any]) -> bool:
    """Whether a picture that was a JPEG, (H, W) or (H, W, C), ends in what decoders fill in: data that were lost on the way leave
    too few blocks, and all behind them show the ground elsewhere."""
    return pixels.dtype == np.uint8 and bool((pixels[-_CORNER_PX:, -_CORNER_PX:] == _FILL).all())


def as_stored(video: cv2.VideoCapture) -> cv2.VideoCapture:
    """An opened video without the turn that its file proposes to viewers, as images are read without that of EXIF."""
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _is_cut_jpeg(data: bytes) -> bool:
    """Whether a JPEG has no end behind its first scan: decoders fill what is missing with grey. Scans hold no end by chance."""
    at = len(_JPEG)
    if not data.startswith(_JPEG):
        return False
    while at + 4 <= len(data) and data[at] == 0xFF:
        if data[at + 1] == _SCAN:
            return data.find(_END, at) < 0
        at += 1 if data[at + 1] == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return True


def _in_8_bits(pixels: NDArray[Any]) -> Image:
    if pixels.dtype == np.uint8:
        return np.asarray(pixels, dtype=np.uint8)
    values = np.nan_to_num(pixels.astype(np.float32))
    low, high = np.percentile(values, [0.1, 99.9])
    return np.asarray(np.clip((values - low) * (255 / max(high - low, 1e-6)), 0, 255), dtype=np.uint8)


def rgb(bgr: NDArray[Any]) -> Image:
    """Pixels as OpenCV gives them, (H, W) or (H, W, C) of 8 or more bits, as ours: grey (H, W) or RGB (H, W, 3) of 8 bits.

    What an alpha channel (or the filler of BGRx) holds is no part of the picture.
    """
    pixels = _in_8_bits(bgr)
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return pixels.reshape(pixels.shape[:2])
    return np.ascontiguousarray(pixels[:, :, 2::-1])


def require_size(width_px: int, height_px: int, model: CameraModel, where: str) -> None:
    """Raises PictureSizeError naming the source, both sizes and the remedy where an image is not of the calibration's size."""
    if (width_px, height_px) != (model.width_px, model.height_px):
        raise PictureSizeError(
            f"image is {width_px}x{height_px}, the calibration is for {model.width_px}x{model.height_px}",
            where=where,
            remedy="set the camera to the calibrated size, or calibrate at this size and correct section [camera]",
        )


def stored(slots: FrameSlots, pixels: Image, frame_id: int, t_rx_ns: int, t_ns: int, t_boot_ns: int | None = None) -> FrameRef:
    """Write pixels into a slot and say where they lie."""
    slot = slots.write(pixels)
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    checksum = zlib.crc32(pixels[::CHECKED_ROWS].tobytes())
    return FrameRef(t_rx_ns, t_ns, frame_id, slot, pixels.shape[1], pixels.shape[0], channels, t_boot_ns, checksum)
