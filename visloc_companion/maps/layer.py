"""Pixels of one grid at several levels: level k has pixels of 2^k x 2^k of level 0, from memory or from a GeoTIFF.

Values are float32 or uint8, (rows, cols) or (rows, cols, 3); validity is uint8, 0 or 255. Levels are cut to whole blocks of
2 x 2 (never padded), so that the centre of level k's pixel u lies exactly at 2^k (u + 0.5) - 0.5 of level 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

SMALLEST_LEVEL_PX = 32
Values = NDArray[Any]
Validity = NDArray[np.uint8]


class Layer(Protocol):
    """A raster with levels."""

    @property
    def T_map_pix(self) -> FloatArray:
        """(2, 3) of level 0."""

    @property
    def channels(self) -> int:
        """1 (values are (rows, cols)) or 3."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the values."""

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(rows, cols) of every level."""

    def read(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """Values and validity of rows[0]:rows[1], cols[0]:cols[1], which lie within the level."""


@dataclass(frozen=True, slots=True, eq=False)
class ArrayLayer:
    """A layer in memory."""

    T_map_pix: FloatArray
    levels: tuple[tuple[Values, Validity], ...]

    @property
    def channels(self) -> int:
        """1 or 3."""
        return 1 if self.levels[0][0].ndim == 2 else int(self.levels[0][0].shape[2])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the values."""
        return self.levels[0][0].dtype

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(rows, cols) of every level."""
        return tuple((int(values.shape[0]), int(values.shape[1])) for values, _ in self.levels)

    def read(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """Views of the arrays."""
        values, valid = self.levels[level]
        window = slice(*rows), slice(*cols)
        return values[window], valid[window]


def level_shapes(rows: int, cols: int) -> tuple[tuple[int, int], ...]:
    """Level 0 and its halvings, the last not smaller than SMALLEST_LEVEL_PX."""
    shapes = [(rows, cols)]
    while min(shapes[-1]) >= 2 * SMALLEST_LEVEL_PX:
        shapes.append((shapes[-1][0] // 2, shapes[-1][1] // 2))
    return tuple(shapes)


def array_layer(T_map_pix: FloatArray, values: Values, valid: NDArray[np.bool_]) -> ArrayLayer:
    """Build the levels by averaging valid pixels of 2 x 2; a block is valid when at least half of it is."""
    levels: list[tuple[Values, Validity]] = [(values, valid.astype(np.uint8) * np.uint8(255))]
    for _ in level_shapes(*values.shape[:2])[1:]:
        levels.append(halved(*levels[-1]))
    return ArrayLayer(T_map_pix, tuple(levels))


def halved(values: Values, valid: Validity) -> tuple[Values, Validity]:
    """The next coarser level."""
    rows, cols = values.shape[0] // 2, values.shape[1] // 2
    size = (cols, rows)
    values, valid = values[: 2 * rows, : 2 * cols], valid[: 2 * rows, : 2 * cols]
    if valid.all():
        return cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.full((rows, cols), 255, np.uint8)
    share = cv2.resize((valid > 0).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mask = valid > 0 if values.ndim == 2 else (valid > 0)[..., None]
    total = cv2.resize(np.where(mask, values, 0).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean = total / np.maximum(share if values.ndim == 2 else share[..., None], 0.25)
    if values.dtype == np.uint8:
        mean = np.clip(np.rint(mean), 0, 255)
    return mean.astype(values.dtype), (share >= 0.5).astype(np.uint8) * np.uint8(255)
