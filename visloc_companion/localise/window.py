"""Windows of the map at a working resolution, with features, in the localiser's metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.features.base import Features, Float32Array
from visloc_companion.localise.features.gradient import eroded
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.localise.plan import LocalFrame
from visloc_companion.localise.working_gsd import working_gsd_m
from visloc_companion.protocols import FeatureMap, ReferenceMap
from visloc_companion.types import FeaturePatch, FloatArray

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

    Where the map holds the features, of this name and recipe, they are taken from it at the stored GSD nearest to `gsd_m` (see
    `working_gsd_m`; `MapGrid.gsd_m` is the one that was used) and no pixel is read; else they are computed.
    Raises OutsideMap where no pixel is on the map.
    """
    middle = (low_ne_m + high_ne_m) / 2
    half = (high_ne_m - low_ne_m) / 2
    centre = frame.to_map(middle)
    gsd_m = working_gsd_m(ref, centre, gsd_m, features)
    up = np.linalg.solve(frame.J_map_ne, np.array([0.0, 1.0]))
    c, s = np.abs(up) / np.linalg.norm(up)
    width, height = (
        min(MAX_SIDE_PX, max(8, math.ceil(2 * extent / gsd_m) + 1))
        for extent in (c * half[1] + s * half[0], c * half[0] + s * half[1])
    )
    patch = _feature_patch(ref, centre, (width, height), gsd_m, features)
    return MapGrid(
        np.asarray(patch.features, dtype=np.float32),
        eroded(patch.valid, 3),
        _filled(patch.dsm_amsl_m, patch.valid),
        frame.A_ne_pix(patch.T_map_pix),
        patch.gsd_m,
    )


def _feature_patch(
    ref: ReferenceMap, centre: tuple[float, float], size_px: tuple[int, int], gsd_m: float, features: Features
) -> FeaturePatch:
    stored = ref.stored_patch(centre, size_px, gsd_m, features.name, features.recipe) if isinstance(ref, FeatureMap) else None
    if stored is not None:
        return stored
    patch = ref.patch(centre, size_px, gsd_m, 0.0)
    return FeaturePatch(features(patch.pixels, patch.valid), patch.valid, patch.dsm_amsl_m, patch.T_map_pix, patch.gsd_m)


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


def thinned(grid: MapGrid, stride: int) -> MapGrid:
    """Every `stride`-th row and column of a window; `gsd_m` stays that of its features."""
    if stride == 1:
        return grid
    features, weight, surface = (
        np.ascontiguousarray(a[::stride, ::stride]) for a in (grid.features, grid.weight, grid.surface_up_m)
    )
    return MapGrid(features, weight, surface, grid.A_ne_pix * np.array([stride, stride, 1.0]), grid.gsd_m)


def _filled(heights: NDArray[np.float32], valid: NDArray[np.bool_]) -> Float32Array:
    known = np.isfinite(heights) & valid
    if known.all():
        return np.asarray(heights, dtype=np.float32)
    fill = float(np.median(heights[known])) if known.any() else 0.0
    return np.where(np.isfinite(heights), heights, np.float32(fill)).astype(np.float32)
