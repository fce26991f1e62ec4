"""Features that look like a network's and cost nothing: for tests of packs and localisers that need no model."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask, without_margin
from visloc_companion.localise.features.gradient import gradient_features, grey


@dataclass(frozen=True, slots=True)
class FakeNetwork:
    """Ten channels (localise.features.base.Features): the gradient's two, and differences of Gaussians of the grey values."""

    name: str = "fake-0123456789ab"
    recipe: str = "fake 1"
    channels: int = 10
    oriented: int = 1
    bound: float = 2.0
    context_px: int = 88
    tolerance: tuple[float, float] | None = None

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        """(H, W, channels) float32, zero where not valid."""
        smooth = [cv2.GaussianBlur(grey(image) * valid / 64, (0, 0), 1.0 + 0.5 * k) for k in range(self.channels - 1)]
        learned = [np.clip(a - b, -self.bound, self.bound) for a, b in pairwise(smooth)]
        values = np.concatenate([gradient_features(image, valid), np.dstack(learned)], axis=2)
        return without_margin(np.asarray(values * valid[..., None], dtype=np.float32), margin_px)
