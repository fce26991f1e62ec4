"""Windows of the map at a working resolution, with features, in the localiser's metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Features, Float32Array
from visloc_companion.localise.features.gradient import eroded
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.plan import LocalFrame
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray

MAX_SIDE_PX = 4000


def map_grid(
    ref: ReferenceMap,
    frame: LocalFrame,
    low_ne_m: FloatArray,
    high_ne_m: FloatArray,
    gsd_m: float,
    features: Features,
) -> MapGrid:
    """The map over a box of metres north, east (grown to the map's axes), along grid north.

    Features come from the map where it holds them (`ReferencePatch.features[features.name]`), else they are computed.
    Raises OutsideMap where no pixel is on the map.
    """
    centre = (low_ne_m + high_ne_m) / 2
    half = (high_ne_m - low_ne_m) / 2
    up = np.linalg.solve(frame.J_map_ne, np.array([0.0, 1.0]))
    c, s = np.abs(up) / np.linalg.norm(up)
    size = tuple(
        min(MAX_SIDE_PX, max(8, math.ceil(2 * extent / gsd_m) + 1))
        for extent in (c * half[1] + s * half[0], c * half[0] + s * half[1])
    )
    patch = ref.patch(frame.to_map(centre), (size[0], size[1]), gsd_m, 0.0)
    values = patch.features.get(features.name)
    if values is None:
        values = features(patch.pixels, patch.valid)
    return MapGrid(
        np.asarray(values, dtype=np.float32),
        eroded(patch.valid, 3),
        _filled(patch.dsm_amsl_m, patch.valid),
        frame.A_ne_pix(patch.T_map_pix),
        gsd_m,
    )


def cropped(grid: MapGrid) -> MapGrid:
    """The part of a window that holds valid map."""
    rows, cols = np.flatnonzero(grid.weight.any(1)), np.flatnonzero(grid.weight.any(0))
    if not len(rows):
        return grid
    r, c = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    A = grid.A_ne_pix.copy()
    A[:, 2] += A[:, :2] @ np.array([cols[0], rows[0]], dtype=np.float64)
    return MapGrid(
        np.ascontiguousarray(grid.features[r, c]),
        np.ascontiguousarray(grid.weight[r, c]),
        np.ascontiguousarray(grid.surface_up_m[r, c]),
        A,
        grid.gsd_m,
    )


def _filled(heights: NDArray[np.float32], valid: NDArray[np.bool_]) -> Float32Array:
    known = np.isfinite(heights) & valid
    if known.all():
        return np.asarray(heights, dtype=np.float32)
    fill = float(np.median(heights[known])) if known.any() else 0.0
    return np.where(np.isfinite(heights), heights, np.float32(fill)).astype(np.float32)
