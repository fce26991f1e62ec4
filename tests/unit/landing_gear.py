"""Landing gear in view of a camera, and the mask that says so."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import CameraMask, CameraModel, Image


def legs(width_px: int, height_px: int) -> NDArray[np.bool_]:
    """Skids along the lower half and two struts: about half of the picture."""
    at = np.zeros((height_px, width_px), np.uint8)
    cv2.rectangle(at, (0, height_px * 5 // 8), (width_px, height_px), 1, -1)
    for foot, hip in ((0.1, 0.25), (0.9, 0.75)):
        cv2.line(at, (round(foot * width_px), height_px), (round(hip * width_px), 0), 1, width_px // 10)
    return at > 0


def masked(model: CameraModel) -> CameraModel:
    return replace(model, mask=CameraMask.of(~legs(model.width_px, model.height_px)))


def with_gear(pixels: Image, seed: int = 5) -> Image:
    """The frame with textured gear where its mask is, the same in every frame of a seed."""
    height, width = pixels.shape[:2]
    grain = np.random.default_rng(seed).normal(0, 60, (height // 8, width // 8)).astype(np.float32)
    gear = np.clip(60 + cv2.resize(grain, (width, height)), 0, 255).astype(np.uint8)
    at = legs(width, height)
    return np.where(at if pixels.ndim == 2 else at[..., None], gear if pixels.ndim == 2 else gear[..., None], pixels)
