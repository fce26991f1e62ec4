"""The picture that `camera.mask` names, or a case of an evaluation."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from visloc_companion.config_camera import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.types import CameraMask

PNG = b"\x89PNG\r\n\x1a\n"
HALF = 127
_PAINT = "make it an 8-bit PNG, black where the camera sees its own vehicle, white where ground (docs/on-a-drone.md, Mask)"
_PAINT_OVER = "paint it over a frame as it comes; camera.width_px and height_px of a configuration are that size"


def read_mask(camera: CameraConfig) -> CameraMask | None:
    """Where the section's camera sees ground; None where it names no mask. Raises ConfigError for a file that is missing or is
    another than `mask_sha256` says, and as `decode_mask`."""
    return decode_mask(_content(camera), camera.width_px, camera.height_px, stated(camera)) if camera.mask else None


def decode_mask(content: bytes, width_px: int, height_px: int, where: str) -> CameraMask:
    """The mask that a file holds. Raises ConfigError where it is no 8-bit PNG, is not of the frames' size, or shows no ground."""
    import cv2  # takes long, and a start without a mask waits for none of it

    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content.startswith(PNG) else None
    if pixels is None:
        raise ConfigError("is damaged" if content.startswith(PNG) else "is no PNG", where=where, remedy=_PAINT)
    if pixels.dtype != np.uint8:
        raise ConfigError(f"has {8 * pixels.dtype.itemsize} bits a channel", where=where, remedy=_PAINT)
    if (size := pixels.shape[1::-1]) != (width_px, height_px):
        what = f"has {size[0]} x {size[1]} pixels, frames have {width_px} x {height_px}"
        raise ConfigError(what, where=where, remedy=_PAINT_OVER)
    if pixels.ndim == 3 and pixels.shape[2] == 4 and pixels[..., 3].min() < 255:
        raise ConfigError(
            "is transparent in places", where=where, remedy="flatten it to black and white, without an alpha channel"
        )
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels[..., :3], cv2.COLOR_BGR2GRAY)
    ground = grey > HALF
    if not ground.any():
        what = f"is black all over (its brightest pixel is {int(grey.max())} of 255)"
        raise ConfigError(what, where=where, remedy="make ground white, 255")
    return CameraMask.of(ground)


def stated(camera: CameraConfig) -> str:
    """Key and file of a section's mask, for messages."""
    return f"camera.mask = {camera.mask}"


def _content(camera: CameraConfig) -> bytes:
    try:
        content = Path(camera.mask).read_bytes()
    except OSError as why:
        remedy = "name the mask's file, relative to the file that names it, or leave camera.mask out"
        raise ConfigError(f"cannot be read: {why.strerror}", where=stated(camera), remedy=remedy) from why
    if camera.mask_sha256 and (found := hashlib.sha256(content).hexdigest()) != camera.mask_sha256:
        what = f"is another file than the one that was used: its SHA-256 is {found}, camera.mask_sha256 = {camera.mask_sha256}"
        raise ConfigError(what, where=stated(camera), remedy="bring that file back, or remove camera.mask_sha256")
    return content
