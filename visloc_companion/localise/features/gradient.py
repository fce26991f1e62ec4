"""Double-angle gradient orientation: what two photographs years apart still share.

An edge keeps its direction when crops, light or season turn its contrast round; the double angle makes both contrasts the
same vector. The magnitude is divided by its local mean, so that a faint hedge counts as much as a white road, and clipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask, without_margin

LOCAL_MEAN_SIGMA_PX = 20.0
CLIP = 2.0
SMOOTHING_SIGMA_PX = 0.8
NOISE_FLOOR = 0.3
"""Grey levels per pixel added to the local mean: keeps sensor noise on plain surfaces from being blown up to texture."""


@dataclass(frozen=True, slots=True)
class GradientFeatures:
    """`gradient_features` as localise.features.base.Features."""

    name: str = "gradient"
    recipe: str = f"smoothing {SMOOTHING_SIGMA_PX:g} mean {LOCAL_MEAN_SIGMA_PX:g} floor {NOISE_FLOOR:g} clip {CLIP:g}"
    channels: int = 2
    oriented: int = 1
    bound: float = CLIP
    context_px: int = 80
    """Reach of the local mean: four sigmas, a multiple of the 4 px of its thinning."""
    tolerance: tuple[float, float] | None = None

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        """See `gradient_features`."""
        return without_margin(gradient_features(image, valid), margin_px)


def grey(image: NDArray[np.uint8] | Float32Array) -> Float32Array:
    """(H, W) float32 luminance of a grey or RGB image."""
    if image.ndim == 2:
        return image.astype(np.float32)
    return np.asarray(cv2.transform(image.astype(np.float32), np.array([[0.299, 0.587, 0.114]])), dtype=np.float32)


def gradient_features(image: NDArray[np.uint8] | Float32Array, valid: Mask) -> Float32Array:
    """(H, W, 2) float32: cosine and sine of twice the gradient's angle, times the normalised magnitude (0 to CLIP).

    `image` is (H, W) or (H, W, 3) RGB, `valid` (H, W). Invalid pixels and their neighbours are zero. The angle is that of the
    image axes: u to the right, v down. Source: double-angle representation of orientation, Granlund 1978.
    """
    smooth = cv2.GaussianBlur(grey(image), (0, 0), SMOOTHING_SIGMA_PX)
    gx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32)
    gy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32)
    inside = eroded(valid, 3)
    magnitude = np.sqrt(gx * gx + gy * gy) * inside  # cv2.magnitude's last bit depends on where in memory the arrays lie
    mean = local_mean(np.asarray(magnitude, dtype=np.float32), inside, LOCAL_MEAN_SIGMA_PX)
    scale = np.minimum(1 / (mean + NOISE_FLOOR), CLIP / np.maximum(magnitude, 1e-6)) * inside / np.maximum(magnitude, 1e-6)
    return np.dstack([(gx * gx - gy * gy) * scale, 2 * gx * gy * scale]).astype(np.float32)


def eroded(valid: Mask, radius_px: int) -> Float32Array:
    """The mask as float32 without the pixels within `radius_px` of an invalid one (the image's own border does not count)."""
    if valid.all():
        return np.ones(valid.shape, np.float32)
    kernel = np.ones((2 * radius_px + 1, 2 * radius_px + 1), np.uint8)
    return np.asarray(cv2.erode(valid.astype(np.uint8), kernel), dtype=np.float32)


def local_mean(values: Float32Array, weight: Float32Array, sigma_px: float) -> Float32Array:
    """Gaussian local mean of the weighted pixels, computed at a quarter of the size (it is smooth anyway)."""
    height, width = values.shape
    small = (max(1, width // 4), max(1, height // 4))
    sigma = (sigma_px * small[0] / width, sigma_px * small[1] / height)
    sums = [
        cv2.GaussianBlur(
            cv2.resize(v, small, interpolation=cv2.INTER_AREA),
            (0, 0),
            sigmaX=sigma[0],
            sigmaY=sigma[1],
            borderType=cv2.BORDER_REFLECT,
        )
        for v in (values * weight, weight)
    ]
    mean = sums[0] / np.maximum(sums[1], 1e-3)
    return np.asarray(cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


GRADIENT = GradientFeatures()
