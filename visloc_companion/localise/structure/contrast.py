"""Pictures with brightness and contrast evened out: exposure, vignetting and haze go, faint fields become as rich as villages."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.types import Image

LOCAL_PX = 31
NOISE_GREY = 4.0
"""Grey levels added to the local spread: a sensor's noise on a plain surface is not blown up to a texture."""


def evened(picture: Image) -> Float32Array:
    """(H, W) deviation from the local mean in local standard deviations."""
    image = picture.astype(np.float32)
    mean = cv2.blur(image, (LOCAL_PX, LOCAL_PX))
    spread = cv2.sqrt(np.maximum(cv2.blur(image * image, (LOCAL_PX, LOCAL_PX)) - mean * mean, 0)) + np.float32(NOISE_GREY)
    return np.asarray((image - mean) / spread, dtype=np.float32)


def as_bytes(values: Float32Array) -> Image:
    """Evened values as grey levels: 40 for each standard deviation about 128."""
    return np.asarray(np.clip(values * 40 + 128, 0, 255), dtype=np.uint8)
