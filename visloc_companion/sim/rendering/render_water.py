"""Open water as a camera sees it: waves and glitter that are elsewhere in the next frame."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import Image

Plane = NDArray[np.float32]
COLOR = (58.0, 74.0, 80.0)
WAVES = ((2.0, 5.0), (6.0, 5.0), (20.0, 4.0))
"""Sizes (Gaussian sigma, pixels) and strengths (1-sigma, grey values) of ripples, waves and gusts."""
GLITTER = 0.002
"""Share of the pixels that flash in the sun."""


def rippled(pixels: Image, share: Plane, seed: int) -> Image:
    """The picture (H, W, 3) with water where `share` (H, W, 0 to 1) says so; the waves are drawn from the seed alone."""
    if not share.any():
        return pixels
    rng = np.random.default_rng((seed, 77))
    height, width = share.shape
    grey = np.zeros((height, width), np.float32)
    for size_px, strength in WAVES:
        small = max(1, int(size_px / 2))
        noise = rng.standard_normal((height // small + 1, width // small + 1), dtype=np.float32)
        swell = cv2.GaussianBlur(noise, (0, 0), size_px / small)
        grey += cv2.resize(swell * np.float32(strength / max(float(swell.std()), 1e-6)), (width, height))
    grey[rng.random((height, width), dtype=np.float32) < GLITTER] += 120.0
    water = grey[:, :, None] + np.array(COLOR, np.float32)
    mixed = pixels + (water - pixels) * share[:, :, None]
    return np.asarray(np.clip(mixed, 0, 255), dtype=np.uint8)
