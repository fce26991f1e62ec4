"""What all cameras share: decoding images, checking their size against the calibration, and the reference of a stored frame."""

from __future__ import annotations

import zlib

import cv2
import numpy as np

from visloc_companion.errors import CameraError
from visloc_companion.protocols import FrameSlots
from visloc_companion.types import CameraModel, FrameRef, Image

CHECKED_ROWS = 8
"""Every so many rows count for a frame's checksum: enough for noise to tell two exposures apart, in less than a millisecond."""


def decode_image(data: bytes) -> Image | None:
    """(H, W, 3) RGB of a PNG or JPEG file's bytes; None where they are damaged."""
    if not data:
        return None
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if pixels is None else rgb(np.asarray(pixels, dtype=np.uint8))


def rgb(bgr: Image) -> Image:
    """OpenCV's channel order to ours; grey stays grey."""
    return bgr if bgr.ndim == 2 else np.ascontiguousarray(bgr[:, :, ::-1])


def require_size(width_px: int, height_px: int, model: CameraModel, where: str) -> None:
    """Raises CameraError naming the source, both sizes and the remedy where an image is not of the calibration's size."""
    if (width_px, height_px) != (model.width_px, model.height_px):
        raise CameraError(
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
