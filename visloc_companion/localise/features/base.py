"""What a dense feature function is: the seam between the networks, the pack's stored features and the localisers."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Mask = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)


class Features(Protocol):
    """Dense features of an image at one resolution, on the image's own pixels.

    `name` is the key under which a map pack stores them, `recipe` says what they were computed with (features of another recipe
    must not be compared with these). Of the `channels` the first `2 * oriented` are pairs (cosine, sine of twice an angle of the
    image axes) and turn with the image; the others do not. Values lie within ±`bound`. `context_px`: how far a pixel's features
    depend on the image around it.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def recipe(self) -> str: ...  # noqa: D102

    @property
    def channels(self) -> int: ...  # noqa: D102

    @property
    def oriented(self) -> int: ...  # noqa: D102

    @property
    def bound(self) -> float: ...  # noqa: D102

    @property
    def context_px(self) -> int: ...  # noqa: D102

    @property
    def tolerance(self) -> tuple[float, float] | None:
        """Turn (radians) and change of scale (logarithm) that features computed once may be resampled by.

        None: quick to compute, so that every pose gets its own.
        """
        ...

    def __call__(self, image: NDArray[np.uint8] | Float32Array, valid: Mask, margin_px: int = 0) -> Float32Array:
        """(H, W, channels) float32 of an (H, W) or (H, W, 3) RGB image; zero where `valid` (H, W) is not.

        `margin_px` around the image are only seen, and cut off: of H - 2 margin_px rows and W - 2 margin_px columns there are
        features then, the same as without.
        """
        ...


def without_margin(whole: NDArray[Scalar], margin_px: int) -> NDArray[Scalar]:
    """An (H, W, ...) array without the `margin_px` around it."""
    return whole[margin_px : whole.shape[0] - margin_px, margin_px : whole.shape[1] - margin_px]
