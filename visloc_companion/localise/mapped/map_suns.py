"""Suns over the map's picture, tile by tile: each is looked for once, whoever asks about it first."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.sun import turned
from visloc_companion.localise.features.grey import GREY
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.mapped.light import WORKING_M, sun_over, up_azimuth_deg
from visloc_companion.localise.mapped.window import map_grid
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, Sun

TILE_M, MARGIN_M = 128.0, 64.0
"""Side of a tile, and what is looked at about it."""


class MapSuns:
    """A mosaic may have another sun in each of its pictures. Answers depend on the place alone, not on what was asked before."""

    def __init__(self) -> None:
        self._ref: ReferenceMap | None = None
        self._found: dict[tuple[int, int, int], Sun | None] = {}

    def over(self, ref: ReferenceMap, frame: LocalFrame, ne_m: FloatArray) -> Sun | None:
        """The sun over the tile that holds a place (2,), metres north and east; None where it does not show there, or the tile
        holds no map (a camera that looks into a gap sees the map around it)."""
        if ref is not self._ref:
            self._ref, self._found = ref, {}
        octave = round(math.log2(frame.map_units_per_m))
        side = TILE_M * 2.0**octave  # in the map's units, the same all over a map
        col, row = (math.floor(x / side) for x in frame.to_map(ne_m))
        if (octave, col, row) not in self._found:
            middle = np.array([(col + 0.5) * side, (row + 0.5) * side]) - frame.origin_map
            self._found[octave, col, row] = _sun_about(ref, frame, np.asarray(np.linalg.solve(frame.J_map_ne, middle)))
        return self._found[octave, col, row]


def _sun_about(ref: ReferenceMap, frame: LocalFrame, ne_m: FloatArray) -> Sun | None:
    half = TILE_M / 2 + MARGIN_M
    try:
        grid = map_grid(ref, frame, ne_m - half, ne_m + half, max(WORKING_M, ref.gsd_m), GREY)
    except OutsideMap:
        return None
    sun = sun_over(grid.features[..., 0], grid.weight > 0, grid.surface_up_m, grid.gsd_m)
    return None if sun is None else turned(sun, up_azimuth_deg(grid.A_ne_pix))
