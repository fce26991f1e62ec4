"""Where a map can be matched: cells with enough gradients, and in more than one direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import FloatArray

LEVEL = 4
"""Stored level that is judged, four times coarser than the map: most of the sensor's noise is averaged out, structure is not."""
CELL_PX = 16
MIN_TEXTURE = 0.4
"""Mean magnitude of the gradient features: a mean gradient of 0.4 grey levels a pixel."""
MAX_COHERENCE = 0.9
"""Share of the gradients that have one direction; rows and shores above it leave the place along them open."""
NOISE_LEFT = 0.5
"""Of the contrast, where 4 x 4 pixels are averaged: 0.25 of noise, up to 0.48 where JPEG has stored it, and of cells of land at
least 0.65 (NAIP of 5 m) or 0.82 (a town of 0.16 m)."""
MIN_VALID = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Matchability:
    """Cells of a map, (rows, cols): texture (NaN without content), coherence in [0, 1], how much of the contrast is left where
    4 x 4 pixels are averaged, and where the cells lie."""

    texture: FloatArray
    coherence: FloatArray
    contrast_left: FloatArray
    T_map_cell: FloatArray
    cell_m: float

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells that hold map."""
        return np.isfinite(self.texture)

    @property
    def flat(self) -> NDArray[np.bool_]:
        """Cells with too little texture, or none but noise: water, snow, bare ground."""
        return self.known & ((np.nan_to_num(self.texture) < MIN_TEXTURE) | (self.contrast_left < NOISE_LEFT))

    @property
    def one_way(self) -> NDArray[np.bool_]:
        """Textured cells whose gradients all have one direction."""
        return self.known & ~self.flat & (self.coherence > MAX_COHERENCE)

    @property
    def good(self) -> NDArray[np.bool_]:
        """Cells that can be matched."""
        return self.known & ~self.flat & ~self.one_way

    def at(self, map_m: FloatArray) -> NDArray[np.bool_]:
        """(N,) whether (N, 2) places lie in cells that can be matched."""
        cells = np.rint(apply_affine(invert_affine(self.T_map_cell), map_m)).astype(int)
        rows, cols = self.texture.shape
        inside = ((cells >= 0) & (cells < [cols, rows])).all(axis=1)
        cells = np.clip(cells, 0, [cols - 1, rows - 1])
        return np.asarray(inside & self.good[cells[:, 1], cells[:, 0]], dtype=np.bool_)


def matchability(pack: PackMap) -> Matchability:
    """Judge the stored gradients at four times the map's GSD (coarsest, where there is none), in cells of 16 px of it."""
    gradients = [entry for entry in pack.stored if entry.level.name == GRADIENT.name]
    stored = gradients[min(LEVEL, len(gradients) - 1)]
    rows, cols = (-(-n // CELL_PX) for n in (stored.level.rows, stored.level.cols))
    texture, coherence = np.full((rows, cols), np.nan), np.zeros((rows, cols))
    for row in range(rows):
        height = min(CELL_PX, stored.level.rows - row * CELL_PX)
        band, _ = stored.window((0, row * CELL_PX), (stored.level.cols, height))
        magnitude = np.hypot(band[..., 0], band[..., 1])
        for col in range(cols):
            part = slice(col * CELL_PX, (col + 1) * CELL_PX)
            texture[row, col], coherence[row, col] = _judge(magnitude[:, part], band[:, part])
    a, b, c, d, e, f = stored.level.transform
    half = CELL_PX / 2
    T_map_cell = np.array([[a * CELL_PX, b, c + a * half], [d, e * CELL_PX, f + e * half]])
    _mask_unknown(pack, T_map_cell, texture)
    side_px = max(4, 4 * round(CELL_PX * stored.level.gsd_m / pack.gsd_m / 4))
    left = pack.contrast_left(T_map_cell, (cols, rows), side_px)
    return Matchability(texture, coherence, left, T_map_cell, stored.level.gsd_m * CELL_PX)


def _judge(magnitude: NDArray[np.float32], features: NDArray[np.float32]) -> tuple[float, float]:
    mean = float(magnitude.mean())
    vector = features.reshape(-1, 2).mean(axis=0)
    return mean, float(np.hypot(*vector)) / max(mean, 1e-6)


def _mask_unknown(pack: PackMap, T_map_cell: FloatArray, texture: FloatArray) -> None:
    """NaN where less than half of a cell holds map; texture is per valid pixel elsewhere."""
    rows, cols = texture.shape
    share = pack.share_valid(T_map_cell, (cols, rows))
    with np.errstate(invalid="ignore"):
        texture[:] = np.where(share >= MIN_VALID, texture / np.maximum(share, MIN_VALID), np.nan)
