"""The camera frame, prepared: checked, undistorted and reduced to the working resolution without aliasing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import pinhole_matrix
from visloc_companion.geo.lens import is_bent, reach_tan
from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.features.gradient import grey
from visloc_companion.localise.lens_maps import where_seen
from visloc_companion.localise.masked import ground_of
from visloc_companion.types import CameraModel, FloatArray, Image

DARK_GREY = 25.0
BRIGHT_GREY = 228.0
MIN_CONTRAST = 2.5
NOISE_LEFT = 0.35
"""Of the contrast, where 4 x 4 pixels are averaged: 0.25 of white noise, 0.8 and more of ground by day."""
MIDDLE_PX = 480
LEAST_OPEN = 0.125
LEAST_PX = 32
"""A frame's shorter side; smaller ones (a thumbnail) show nothing that could be found."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameLevel:
    """An undistorted frame at one resolution: (H, W) grey float32, (H, W) validity uint8 and the pinhole matrix (3, 3).

    Features of the frame resampled to a plane are one too (frame_features.py): `grey` is (H, W, C) then, and `K` any (3, 3).
    """

    grey: Float32Array
    valid: NDArray[np.uint8]
    K: FloatArray


def check_pixels(pixels: Image, model: CameraModel) -> tuple[Reason, str] | None:
    """Why a frame cannot be localised whatever the map is, or None."""
    return unfit(pixels, model) or _shows_nothing(pixels, None if model.mask is None else ground_of(model))


def unfit(pixels: Image, model: CameraModel) -> tuple[Reason, str] | None:
    """Why pixels are no frame of this camera, or None."""
    if pixels.ndim not in {2, 3} or pixels.shape[:2] != (model.height_px, model.width_px):
        return Reason.BAD_FRAME, f"frame is {pixels.shape}, the calibration is for {model.width_px} x {model.height_px} pixels"
    if pixels.dtype != np.uint8 or (pixels.ndim == 3 and pixels.shape[2] != 3):
        return Reason.BAD_FRAME, f"frame is {pixels.dtype} with shape {pixels.shape}, expected uint8 grey or RGB"
    if min(pixels.shape[:2]) < LEAST_PX:
        return Reason.BAD_FRAME, f"frame has only {model.width_px} x {model.height_px} pixels"
    return None


def _shows_nothing(pixels: Image, ground: NDArray[np.uint8] | None) -> tuple[Reason, str] | None:
    """Why a frame shows nothing where its mask (H, W), 255 for ground, says that there is ground, or None."""
    sample = pixels[::4, ::4] if pixels.ndim == 2 else pixels[::4, ::4, 1]
    of_ground = sample if ground is None else sample[ground[::4, ::4] > 0]
    if not of_ground.size:
        return Reason.LOW_TEXTURE, "the camera's mask, with its margin, leaves no ground"
    low, middle, high = (float(p) for p in np.percentile(of_ground, (5, 50, 95)))
    if high < DARK_GREY:
        return Reason.TOO_DARK, f"95 % of the pixels are darker than {high:.0f} of 255"
    if middle > BRIGHT_GREY and low > BRIGHT_GREY - 15:
        return Reason.OVEREXPOSED, f"95 % of the pixels are brighter than {low:.0f} of 255"
    small = cv2.resize(sample, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    if ground is not None:
        small = small[_wholly(ground[::4, ::4], 0.5) > 0]
    if float(np.std(small)) < MIN_CONTRAST:
        return Reason.LOW_TEXTURE, f"contrast of {float(np.std(small)):.1f} grey levels"
    return _mostly_noise(pixels if pixels.ndim == 2 else pixels[:, :, 1], middle, ground)


def _mostly_noise(channel: Image, middle: float, ground: NDArray[np.uint8] | None) -> tuple[Reason, str] | None:
    """Why a frame with this median shows nothing where neighbours in (H, W) have little in common, or None; also where its
    mask leaves less than LEAST_OPEN of the middle to tell."""
    row, column = (max(0, (n - MIDDLE_PX) // 2) for n in channel.shape)
    middle_part = slice(row, row + MIDDLE_PX), slice(column, column + MIDDLE_PX)
    window = np.ascontiguousarray(channel[middle_part])
    averaged = np.asarray(cv2.resize(window, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    seen, wholly_seen = None, None
    if ground is not None:
        seen, wholly_seen = np.ascontiguousarray(ground[middle_part]), _wholly(ground[middle_part], 0.25)
        if float(np.mean(wholly_seen > 0)) < LEAST_OPEN:
            return None
    contrast, contrast_left = _contrast(window, seen), _contrast(averaged, wholly_seen)
    if contrast == 0.0:
        return Reason.LOW_TEXTURE, "one and the same grey all over its middle"
    left = contrast_left / contrast
    if left >= NOISE_LEFT:
        return None
    reason = Reason.TOO_DARK if middle < DARK_GREY else Reason.LOW_TEXTURE
    return reason, f"noise and little else: averaged over 16 pixels, {100 * left:.0f} % of its contrast is left"


def _contrast(channel: Image, seen: NDArray[np.uint8] | None) -> float:
    """Standard deviation of (H, W), in grey levels, where `seen` (H, W) is not 0; everywhere where it is None."""
    return float(cv2.meanStdDev(channel, mask=seen)[1][0, 0])


def _wholly(ground: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    """The mask (H, W) reduced by a factor: 255 where all that a pixel is made of is ground, else 0."""
    share = cv2.resize(ground, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return np.asarray((share == 255) * np.uint8(255), dtype=np.uint8)


def full_level(pixels: Image, model: CameraModel) -> FrameLevel:
    """The undistorted frame at full resolution. The pinhole matrix stays that of the model."""
    K = pinhole_matrix(model)
    image = grey(pixels)
    valid = np.full(image.shape, 255, np.uint8) if model.mask is None else ground_of(model)
    if is_bent(model):
        map_u, map_v, valid = _undistortion(model)
        image = np.asarray(cv2.remap(image, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)
    return FrameLevel(image, valid, K)


@lru_cache(maxsize=2)
def _undistortion(model: CameraModel) -> tuple[Float32Array, Float32Array, NDArray[np.uint8]]:
    """Where each undistorted pixel is in the frame (u, v), and which show ground there: the same for all frames of a camera.

    Beyond the distortion's reach the polynomial leads back into the frame, to ground that lies elsewhere.
    """
    map_u, map_v = where_seen(model, np.eye(3), pinhole_matrix(model), (model.width_px, model.height_px))
    valid = np.asarray(cv2.remap(ground_of(model), map_u, map_v, cv2.INTER_NEAREST, borderValue=0), dtype=np.uint8)
    reach = reach_tan(model)
    if math.isfinite(reach):
        x = (np.arange(model.width_px) - model.cx_px) / model.fx_px
        y = (np.arange(model.height_px) - model.cy_px) / model.fy_px
        valid = np.where(x**2 + y[:, None] ** 2 < reach**2, valid, np.uint8(0))
    for shared in (map_u, map_v, valid):
        shared.setflags(write=False)
    return map_u, map_v, valid


def reduced(level: FrameLevel, factor: float) -> FrameLevel:
    """The frame resampled so that one of its pixels is about `factor` (> 1: coarser) of the old ones, low-pass filtered.

    Factors below 1.15 return the frame as it is.
    """
    if factor < 1.15:
        return level
    height, width = level.grey.shape
    whole = max(1, int(factor))
    image, valid, K = level.grey, level.valid, level.K
    if whole > 1:
        size = (max(8, width // whole), max(8, height // whole))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        valid = ((cv2.resize(valid, size, interpolation=cv2.INTER_AREA) > 250) * np.uint8(255)).astype(np.uint8)
        su, sv = size[0] / width, size[1] / height
        S = np.array([[su, 0, su / 2 - 0.5], [0, sv, sv / 2 - 0.5], [0, 0, 1]])
        K = S @ K
    rest = factor / whole
    if rest > 1.15:
        image = cv2.GaussianBlur(image, (0, 0), 0.5 * float(np.sqrt(rest * rest - 1))).astype(np.float32)
    return FrameLevel(image, valid, K)
