"""What stands still in a camera's frames while the rest moves: text that a video link burns in, landing gear, dead lines."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import Image

WIDTH_PX, SMOOTHING_PX = 320, 1.0
EDGE_GREY = 5.0
"""Grey levels a pixel of what counts as an edge: noise of 12 grey levels makes hardly any, after the smoothing."""
MOVES, STAYS = 0.6, 0.9
"""Length of the mean gradient over the mean length: that of edges which pass by is below the first, of those which stay above the
other."""
OFTEN, ALWAYS = 0.1, 0.9
"""Shares of the frames in which edges pass by, and in which those that stay are seen."""
LEAST_FRAMES = 10
MOVING_OF_STILL = 0.5
"""The rest moves where so many times as many pixels have edges that pass by: a person in view of a vehicle at rest is not enough,
ground beside gear in half of the picture is."""


class StillEdges:
    """Adds up the gradients of frames. `ground` (H, W) says what of a frame counts: what is masked stands still rightly."""

    def __init__(self, ground: NDArray[np.bool_]) -> None:
        self._ground = ground
        width = min(WIDTH_PX, ground.shape[1])
        self._size = width, max(1, round(ground.shape[0] * width / ground.shape[1]))
        self._n = 0
        self._mean = np.zeros((*self._size[::-1], 2), np.float32)
        self._length, self._times = (np.zeros(self._size[::-1], np.float32) for _ in range(2))

    def add(self, view: Image) -> None:
        """Take a frame (H, W[, 3]); those of another size than `ground` are left out."""
        if view.shape[:2] != self._ground.shape:
            return
        grey = view if view.ndim == 2 else view[..., 1]
        small = cv2.resize(np.ascontiguousarray(grey), self._size, interpolation=cv2.INTER_AREA).astype(np.float32)
        smooth = cv2.GaussianBlur(small, (0, 0), SMOOTHING_PX)
        edges = np.dstack([cv2.Sobel(smooth, cv2.CV_32F, *way, scale=1 / 8) for way in ((1, 0), (0, 1))])
        length = np.hypot(edges[..., 0], edges[..., 1])
        self._mean += edges
        self._length += length
        self._times += length > EDGE_GREY
        self._n += 1

    @property
    def share(self) -> float | None:
        """Share of what is looked at that has the same edges in every frame; None where too little moves to tell."""
        if self._n < LEAST_FRAMES:
            return None
        seen = cv2.resize(self._ground.astype(np.uint8) * 255, self._size, interpolation=cv2.INTER_AREA) == 255
        alike = np.hypot(self._mean[..., 0], self._mean[..., 1]) / np.maximum(self._length, 1e-6)
        still = seen & (alike > STAYS) & (self._times >= ALWAYS * self._n)
        moving = seen & (alike < MOVES) & (self._times >= OFTEN * self._n)
        if moving.sum() <= MOVING_OF_STILL * still.sum():
            return None
        return float(still.sum() / seen.sum())
