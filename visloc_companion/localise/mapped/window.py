"""Windows of the map at a working resolution, with features, in the localiser's metres."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import eroded
from visloc_companion.localise.local_frame import LocalFrame
from visloc_companion.localise.mapped.ground import filled
from visloc_companion.localise.mapped.map_part import worth_reading
from visloc_companion.localise.mapped.relit_tiles import Lit
from visloc_companion.localise.mapped.working_gsd import working_gsd_m
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.protocols import FeatureMap, ReferenceMap
from visloc_companion.types import FeaturePatch, FloatArray

MAX_SIDE_PX = 4000
LEAST_PX = 16
MARGIN_PX = 64
"""About the map in a window of a search: features near the map's edge tell that it ends there."""


def map_grid(
    ref: ReferenceMap,
    frame: LocalFrame,
    low_ne_m: FloatArray,
    high_ne_m: FloatArray,
    gsd_m: float,
    features: Features,
    lit: Lit | None = None,
) -> MapGrid:
    """The map over a box of metres north, east (grown to the map's axes), along grid north.

    Where the map holds the features, of this name and recipe, they are taken from it at the stored GSD nearest to `gsd_m` (see
    `working_gsd_m`; `MapGrid.gsd_m` is the one that was used) and no pixel is read; else they are computed. With `lit` they are
    those of the map under another sun.
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
    if lit is None:
        patch = _feature_patch(ref, centre, (width, height), gsd_m, features)
    else:
        patch = lit.tiles.patch(ref, frame, centre, (width, height), gsd_m, features, lit.light)
    return MapGrid(
        np.asarray(patch.features, dtype=np.float32),
        eroded(patch.valid, 3),
        filled(patch.dsm_amsl_m, patch.valid),
        frame.A_ne_pix(patch.T_map_pix),
        patch.gsd_m,
        patch.dsm_gsd_m,
    )


def searched_map(
    ref: ReferenceMap, frame: LocalFrame, low_ne_m: FloatArray, high_ne_m: FloatArray, gsd_m: float, features: Features
) -> MapGrid:
    """The part of `map_grid` that holds valid map, of which no more is read than the map has, nor than MAX_SIDE_PX a side.

    Raises OutsideMap where no pixel is on the map.
    """
    margin_m = MARGIN_PX * gsd_m
    low, high = worth_reading(ref, frame, low_ne_m, high_ne_m, MAX_SIDE_PX * gsd_m, margin_m)
    return cropped(map_grid(ref, frame, low, high, gsd_m, features))


def _feature_patch(
    ref: ReferenceMap, centre: tuple[float, float], size_px: tuple[int, int], gsd_m: float, features: Features
) -> FeaturePatch:
    stored = ref.stored_patch(centre, size_px, gsd_m, features.name, features.recipe) if isinstance(ref, FeatureMap) else None
    if stored is not None:
        return stored
    patch = ref.patch(centre, size_px, gsd_m, 0.0)
    values = features(patch.pixels, patch.valid)
    return FeaturePatch(values, patch.valid, patch.dsm_amsl_m, patch.T_map_pix, patch.gsd_m, patch.dsm_gsd_m)


def cropped(grid: MapGrid) -> MapGrid:
    """The part of a window that holds valid map."""
    rows, cols = np.flatnonzero(grid.weight.any(1)), np.flatnonzero(grid.weight.any(0))
    if not len(rows):
        return grid
    return _part(grid, slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1))


def part_of_box(grid: MapGrid, low_ne_m: FloatArray, high_ne_m: FloatArray, margin_px: int) -> MapGrid:
    """The part of a window that holds a box of metres north, east and a margin; LEAST_PX a side where the window has that."""
    corners = np.array([[a, b] for a in (low_ne_m[0], high_ne_m[0]) for b in (low_ne_m[1], high_ne_m[1])])
    pix = (corners - grid.A_ne_pix[:, 2]) @ np.linalg.inv(grid.A_ne_pix[:, :2]).T
    height, width = grid.weight.shape
    (u0, v0), (u1, v1) = np.floor(pix.min(0)).astype(int) - margin_px, np.ceil(pix.max(0)).astype(int) + margin_px
    u0, v0 = max(0, min(int(u0), width - LEAST_PX)), max(0, min(int(v0), height - LEAST_PX))
    return _part(grid, slice(v0, max(int(v1), v0 + LEAST_PX)), slice(u0, max(int(u1), u0 + LEAST_PX)))


def _part(grid: MapGrid, rows: slice, cols: slice) -> MapGrid:
    A = grid.A_ne_pix.copy()
    A[:, 2] += A[:, :2] @ np.array([cols.start, rows.start], dtype=np.float64)
    features, weight, surface = (np.ascontiguousarray(a[rows, cols]) for a in (grid.features, grid.weight, grid.surface_up_m))
    return replace(grid, features=features, weight=weight, surface_up_m=surface, A_ne_pix=A)


def thinned(grid: MapGrid, stride: int) -> MapGrid:
    """Every `stride`-th row and column of a window; `gsd_m` stays that of its features."""
    if stride == 1:
        return grid
    features, weight, surface = (
        np.ascontiguousarray(a[::stride, ::stride]) for a in (grid.features, grid.weight, grid.surface_up_m)
    )
    return replace(
        grid, features=features, weight=weight, surface_up_m=surface, A_ne_pix=grid.A_ne_pix * np.array([stride, stride, 1.0])
    )
