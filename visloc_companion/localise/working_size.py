"""Frames that are larger than a step needs, reduced with their calibration."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from visloc_companion.types import CameraModel, Image

LEAST_REDUCTION = 0.9
"""A frame that is hardly too large is not worth resampling."""


def reduced_model(model: CameraModel, most_px: int) -> CameraModel:
    """The model of frames resized to at most so many pixels; itself where that is hardly less."""
    factor = math.sqrt(most_px / (model.width_px * model.height_px))
    if factor >= LEAST_REDUCTION:
        return model
    width, height = round(model.width_px * factor), round(model.height_px * factor)
    across, down = width / model.width_px, height / model.height_px
    fx, fy = model.fx_px * across, model.fy_px * down
    cx, cy = (model.cx_px + 0.5) * across - 0.5, (model.cy_px + 0.5) * down - 0.5
    mask = None if model.mask is None else model.mask.reduced(width, height)
    return replace(model, width_px=width, height_px=height, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, mask=mask)


def resized(pixels: Image, model: CameraModel) -> Image:
    """The frame (H, W[, 3]) at a model's size; itself where it has that already."""
    size = (model.width_px, model.height_px)
    if pixels.shape[:2] == size[::-1]:
        return pixels
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
