"""The shape of the ground about a place, as points for registration: from a pack's cloud, or from its surface model."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.maps.crs import Linearisation
from visloc_companion.types import FloatArray

MAX_POINTS = 2_000_000
"""Enough for a circle of 280 m at eight points a square metre; a larger one is thinned."""
SPACING_M = 0.5
"""A surface model is not sampled more finely than this."""
HeightWindow = Callable[[FloatArray, tuple[int, int]], NDArray[np.float32]]
"""(2, 3) T_map_pix and (width, height) -> heights (height, width), NaN where unknown."""


def sampled_surface(
    window: HeightWindow,
    T_map_pix: FloatArray | None,
    pixel_map: float,
    center_map_m: tuple[float, float],
    radius_map: float,
    max_points: int,
) -> FloatArray:
    """(N, 3) easting, northing, height of a surface model's samples in a circle, at least SPACING_M and a pixel apart.

    (2, 3) `T_map_pix` is the surface model's own where it is in the map's CRS: samples then lie on its pixels.
    """
    step = max(pixel_map, SPACING_M, math.sqrt(math.pi * radius_map**2 / max_points))
    start = np.array([center_map_m[0] - radius_map, center_map_m[1] + radius_map])
    if T_map_pix is not None:
        start = apply_affine(T_map_pix, np.floor(apply_affine(invert_affine(T_map_pix), start)))
    count = math.ceil(2 * radius_map / step) + 2
    heights = window(np.array([[step, 0.0, start[0]], [0.0, -step, start[1]]]), (count, count))
    row, col = np.nonzero(np.isfinite(heights))
    points = np.column_stack([start[0] + step * col, start[1] - step * row, heights[row, col].astype(np.float64)])
    away = np.hypot(points[:, 0] - center_map_m[0], points[:, 1] - center_map_m[1])
    return points[away <= radius_map]


def on_the_ground(points_map: FloatArray, here: Linearisation) -> FloatArray:
    """(N, 3) easting, northing, height to metres true east and true north of the linearisation's origin, and the height as it is.

    Grid convergence and scale are taken out: what is measured on the ground fits it without them.
    """
    north, east = np.linalg.solve(here.J_map_ne, (points_map[:, :2] - here.origin_map_m).T)
    return np.column_stack([east, north, points_map[:, 2]])
