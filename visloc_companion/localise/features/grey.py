"""Brightness itself as a feature: what the baseline `ncc` compares, and where light and shadow are looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Float32Array, Mask, without_margin
from visloc_companion.localise.features.gradient import grey


@dataclass(frozen=True, slots=True)
class GreyFeatures:
    """(H, W, 1) luminance, zero where invalid (localise.features.base.Features)."""

    name: str = "grey"
    recipe: str = "luminance"
    channels: int = 1
    oriented: int = 0
    bound: float = 255.0
    context_px: int = 0
    tolerance: tuple[float, float] | None = None

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        """The luminance."""
        return without_margin((grey(image) * valid)[..., None].astype(np.float32), margin_px)


GREY = GreyFeatures()
