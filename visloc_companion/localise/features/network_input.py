"""What the feature network sees of an image: locally normalised grey and the gradient features; in training as in flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask
from visloc_companion.localise.features.gradient import GRADIENT, gradient_features, grey, local_mean

CHANNELS = 3
NORMALISE_SIGMA_PX = 14.0
DEVIATION_FLOOR = 2.0
"""Grey levels added to the local deviation: plain surfaces are not blown up to texture."""
GREY_CLIP = 3.0
RECIPE = f"grey sigma {NORMALISE_SIGMA_PX:g} floor {DEVIATION_FLOOR:g} clip {GREY_CLIP:g}; gradient {GRADIENT.recipe}"
"""What a network was trained on; it must not be fed anything else."""


def network_input(image: NDArray[np.uint8] | Float32Array, valid: Mask) -> Float32Array:
    """(3, H, W) float32 of an (H, W) or (H, W, 3) RGB image: normalised grey (±3), gradient cosine and sine (±2).

    Zero where `valid` (H, W) is not; what is invalid does not enter the local mean and deviation.
    """
    values, weight = grey(image), valid.astype(np.float32)
    mean = local_mean(values, weight, NORMALISE_SIGMA_PX)
    centred = np.asarray((values - mean) * weight, dtype=np.float32)
    deviation = np.sqrt(np.maximum(local_mean(centred * centred, weight, NORMALISE_SIGMA_PX), 0.0))
    normalised = np.clip(centred / (deviation + np.float32(DEVIATION_FLOOR)), -GREY_CLIP, GREY_CLIP)
    oriented = gradient_features(values, valid)
    return np.ascontiguousarray(np.dstack([normalised, oriented]).transpose(2, 0, 1), dtype=np.float32)
