"""The picture that `camera.mask` names."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from visloc_companion.config import CameraConfig
from visloc_companion.errors import ConfigError
from visloc_companion.types import CameraMask

PNG = b"\x89PNG\r\n\x1a\n"
HALF = 127
_PAINT = "make it an 8-bit PNG, black where the camera sees its own vehicle, white where ground (docs/on-a-drone.md, Mask)"


def read_mask(camera: CameraConfig) -> CameraMask | None:
    """Where the section's camera sees ground; None where it names no mask. Raises ConfigError for a file that is missing, is
    another than `mask_sha256` says, is no 8-bit PNG, is not of the frames' size, or shows no ground."""
    if not camera.mask:
        return None
    import cv2  # takes long, and a start without a mask waits for none of it

    content = _content(camera)
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content.startswith(PNG) else None
    if pixels is None:
        raise mask_error(camera, "is damaged" if content.startswith(PNG) else "is no PNG", _PAINT)
    if pixels.dtype != np.uint8:
        raise mask_error(camera, f"has {8 * pixels.dtype.itemsize} bits a channel", _PAINT)
    if (size := pixels.shape[1::-1]) != (camera.width_px, camera.height_px):
        what = f"has {size[0]} x {size[1]} pixels, frames have {camera.width_px} x {camera.height_px}"
        raise mask_error(camera, what, "paint it over a frame as the daemon gets it; camera.width_px and height_px are that size")
    if pixels.ndim == 3 and pixels.shape[2] == 4 and pixels[..., 3].min() < 255:
        raise mask_error(camera, "is transparent in places", "flatten it to black and white, without an alpha channel")
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels[..., :3], cv2.COLOR_BGR2GRAY)
    ground = grey > HALF
    if not ground.any():
        raise mask_error(camera, f"is black all over (its brightest pixel is {int(grey.max())} of 255)", "make ground white, 255")
    return CameraMask.of(ground)


def mask_error(camera: CameraConfig, what: str, remedy: str) -> ConfigError:
    """What is wrong with the mask, naming key and file."""
    return ConfigError(what, where=f"camera.mask = {camera.mask}", remedy=remedy)


def _content(camera: CameraConfig) -> bytes:
    try:
        content = Path(camera.mask).read_bytes()
    except OSError as why:
        remedy = "name the mask's file, relative to the file that names it, or leave camera.mask out"
        raise mask_error(camera, f"cannot be read: {why.strerror}", remedy) from why
    if camera.mask_sha256 and (found := hashlib.sha256(content).hexdigest()) != camera.mask_sha256:
        what = f"is another file than the one that was used: its SHA-256 is {found}, camera.mask_sha256 = {camera.mask_sha256}"
        raise mask_error(camera, what, "bring that file back, or remove camera.mask_sha256")
    return content
