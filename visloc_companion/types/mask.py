"""What a camera sees of its own vehicle and lens."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CameraMask:
    """Which pixels of a camera show ground: the same in all of its frames, where the others show landing gear or the lens's rim.

    `packed` are the rows one after the other, eight pixels a byte, so that a mask can be compared, hashed and sent like a number.
    """

    width_px: int
    height_px: int
    packed: bytes = field(repr=False)

    @classmethod
    def of(cls, ground: NDArray[np.bool_]) -> Self:
        """From (H, W), true where there is ground."""
        return cls(ground.shape[1], ground.shape[0], np.packbits(ground).tobytes())

    def ground(self) -> NDArray[np.bool_]:
        """(H, W), true where there is ground."""
        bits = np.unpackbits(np.frombuffer(self.packed, np.uint8), count=self.width_px * self.height_px)
        return bits.reshape(self.height_px, self.width_px).astype(np.bool_)

    def reduced(self, width_px: int, height_px: int) -> Self:
        """The mask of frames resized to fewer pixels: one shows ground where all that it is made of does."""
        other = np.zeros((self.height_px + 1, self.width_px + 1), np.int64)
        other[1:, 1:] = (~self.ground()).cumsum(0).cumsum(1)
        (left, right), (top, bottom) = _spans(self.width_px, width_px), _spans(self.height_px, height_px)
        return self.of(other[bottom][:, right] - other[top][:, right] == other[bottom][:, left] - other[top][:, left])

    @property
    def masked_share(self) -> float:
        """Of all pixels, those that show no ground."""
        return 1.0 - float(self.ground().mean())


def _spans(of_px: int, to_px: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(to_px,) the first of the old pixels that each new one covers, and the one after the last."""
    ends = np.arange(to_px + 1, dtype=np.int64) * of_px
    return ends[:-1] // to_px, -(-ends[1:] // to_px)
