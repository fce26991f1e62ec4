"""Rasters all around the earth, opened elsewhere: a mosaic of tiles on both sides of the antimeridian is one, as gdalbuildvrt
makes it, and so are global surface models and images. The seam, where the last column meets the first, lies amid a map that is
there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from visloc_companion.geo.raster import compose_affine
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.layer import Layer, Validity, Values
from visloc_companion.maps.places import pix_of_geo
from visloc_companion.types import FloatArray

_EXACT = 0.01
"""Of a pixel: by how much a turn may not be whole columns."""


@dataclass(frozen=True, slots=True, eq=False)
class RolledLayer:
    """A layer of `turn_px` columns to a turn that begins `start` columns further on. It has level 0 alone."""

    layer: Layer
    turn_px: int
    start: int

    @property
    def T_map_pix(self) -> FloatArray:
        """(2, 3) of level 0."""
        return compose_affine(self.layer.T_map_pix, np.array([[1.0, 0.0, self.start], [0.0, 1.0, 0.0]]))

    @property
    def channels(self) -> int:
        """1 or 3."""
        return self.layer.channels

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the values."""
        return self.layer.dtype

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(rows, cols) of level 0."""
        return ((self.layer.shapes[0][0], self.turn_px),)

    def read(self, level: int, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[Values, Validity]:
        """Values and validity, put together where they lie on both sides of the seam."""
        left, right = cols[0] + self.start, cols[1] + self.start
        spans = [(left, min(right, self.turn_px)), (max(left, self.turn_px) - self.turn_px, right - self.turn_px)]
        parts = [self.layer.read(level, rows, span) for span in spans if span[1] > span[0]]
        if len(parts) == 1:
            return parts[0]
        return np.concatenate([part[0] for part in parts], axis=1), np.concatenate([part[1] for part in parts], axis=1)


def goes_around(layer: Layer, crs: MapCrs) -> bool:
    """Whether its first column follows its last, around the earth."""
    return _columns_of_a_turn(layer, crs) is not None


def seam_away(layer: Layer, crs: MapCrs, lat_lon_deg: tuple[float, float]) -> Layer:
    """The layer, opened on the other side of the earth where it goes all around and its seam lies nearer to a place than its
    middle does; one that was opened there before is opened for this place."""
    if isinstance(layer, RolledLayer):
        layer = layer.layer
    turn_px = _columns_of_a_turn(layer, crs)
    if turn_px is None:
        return layer
    at = float(pix_of_geo(layer, crs, np.array([lat_lon_deg]))[0, 0])
    return RolledLayer(layer, turn_px, turn_px // 2) if not turn_px / 4 <= at <= 3 * turn_px / 4 else layer


def _columns_of_a_turn(layer: Layer, crs: MapCrs) -> int | None:
    """How many columns go around the earth; None of a layer that does not, or not in whole columns."""
    T, (_, cols) = layer.T_map_pix, layer.shapes[0]
    if crs.turn is None or T[0, 1] or T[1, 0]:
        return None
    turn_px = crs.turn / abs(float(T[0, 0]))
    whole = round(turn_px)
    if abs(turn_px - whole) > _EXACT or cols not in (whole, whole + 1):  # the last may repeat the first
        return None
    return whole
