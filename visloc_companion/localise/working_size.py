"""Frames that are larger than a step needs, reduced with their calibration."""

from __future__ import annotations

import math

import cv2
import numpy as np

from visloc_companion.geo.camera import scaled
from visloc_companion.types import CameraModel, Image

LEAST_REDUCTION = 0.9
"""A frame that is hardly too large is not worth resampling."""


def reduced_model(model: CameraModel, most_px: int) -> CameraModel:
    """The model of frames resized to at most so many pixels; itself where that is hardly less."""
    factor = math.sqrt(most_px / (model.width_px * model.height_px))
    return model if factor >= LEAST_REDUCTION else scaled(model, factor)


def resized(pixels: Image, model: CameraModel) -> Image:
    """The frame (H, W[, 3]) at a model's size; itself where it has that already."""
    size = (model.width_px, model.height_px)
    if pixels.shape[:2] == size[::-1]:
        return pixels
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
