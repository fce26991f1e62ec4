"""The raster grid of the procedural landscape, and drawing the plan's vectors on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

SHIFT = 4


@dataclass(frozen=True)
class Grid:
    """A square raster of `size_px` pixels of `gsd_m`; plan coordinates (x, y) lie at pix (x / gsd - 0.5, y / gsd - 0.5)."""

    size_px: int
    gsd_m: float

    def pix(self, points_m: FloatArray) -> FloatArray:
        """(N, 2) plan metres to pix."""
        return points_m / self.gsd_m - 0.5

    def fixed(self, points_m: FloatArray) -> NDArray[np.int32]:
        """(N, 2) plan metres to OpenCV's fixed-point pix."""
        return np.asarray(np.round(self.pix(points_m) * (1 << SHIFT)), dtype=np.int32)

    def fill(self, layer: NDArray[np.integer[Any]], outline_m: FloatArray, value: int) -> None:
        """Fill a closed outline with a value, in place."""
        cv2.fillPoly(layer, [self.fixed(outline_m)], value, lineType=cv2.LINE_8, shift=SHIFT)

    def draw(self, layer: NDArray[np.uint8], points_m: FloatArray, width_m: float, closed: bool = False) -> None:
        """Draw a line of a width with soft edges into an opacity layer (0..255), in place; thin lines become fainter."""
        width_px = width_m / self.gsd_m
        opacity = round(255 * min(1.0, width_px))
        thickness = max(1, round(width_px))
        cv2.polylines(layer, [self.fixed(points_m)], closed, opacity, thickness, cv2.LINE_AA, SHIFT)

    def blank(self) -> NDArray[np.uint8]:
        """An empty opacity layer."""
        return np.zeros((self.size_px, self.size_px), np.uint8)


def inside(points_m: FloatArray, outline_m: FloatArray) -> NDArray[np.bool_]:
    """Which of (N, 2) points lie in a closed outline, to about a metre (looked up in a raster of it)."""
    low = np.floor(outline_m.min(0)) - 1
    width, height = (np.ceil(outline_m.max(0)) - low + 2).astype(int)
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(outline_m - low).astype(np.int32)], 1)
    at = np.round(points_m - low).astype(int)
    ok = (at >= 0).all(1) & (at[:, 0] < width) & (at[:, 1] < height)
    at = np.where(ok[:, None], at, 0)
    return np.asarray(ok & (mask[at[:, 1], at[:, 0]] > 0))
