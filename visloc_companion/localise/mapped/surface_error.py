"""How far the map's surface model may be off where the frame's blocks are matched.

A wood without leaves is seen lower than the model has it, one that was felled is gone, one that has grown is higher; crops come
and go with the year. Where the camera leans, or blocks lie to one side of the picture, that moves and lifts a pose which takes
the model for true. Some of it is the same all over the picture (the season, the years), some goes by within tens of metres
(woods, fields): neighbouring blocks err alike, and many of them tell less than as many that err on their own.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.raster import apply_affine
from visloc_companion.localise.mapped.plane_fit import design_of, plane_through
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.types import FloatArray

OPENED_M = 60.0
"""What is narrower than this and higher than its surroundings stands on the ground; what is wider is ground."""
STEP_M = 3.0
"""Sampling at which that is found."""
SHARE, LOCAL_SHARE = 0.3, 0.3
"""1-sigma of the share of what stands there by which it is higher or lower: of all of it together, and from place to place."""
GROUND_M = 0.3
"""1-sigma of the ground's height, from place to place."""
ALIKE_M = 60.0
"""Places so far apart have exp(-1) of that in common."""
COARSE_M, UNRESOLVED = 20.0, 3.0
"""Between the samples of a surface model so far apart or farther the land is not known: 1-sigma so much of what its own stands
out of a plane, times their distance over the window's side. Set on made land (fractal, 10 to 30 m) and models of 30 and 90 m."""

MOST_PLACES = 60
"""Of a set of them, by which its level and slope are judged."""


def height_covariance(grid: MapGrid, at_px: FloatArray, side_px: float) -> FloatArray:
    """(N, N) covariance (m²) of the surface model's errors over squares of a side about pixels (N, 2)."""
    standing = standing_m(grid, at_px, side_px)
    ne = apply_affine(grid.A_ne_pix, at_px)
    apart_m = np.hypot(*(ne[:, None] - ne[None]).transpose(2, 0, 1))
    both = np.outer(standing, standing)
    alike = np.exp(-apart_m / max(ALIKE_M, grid.dsm_gsd_m))
    ground_m2 = GROUND_M**2 + unresolved_m(grid) ** 2
    return np.asarray(SHARE**2 * both + (ground_m2 + LOCAL_SHARE**2 * both) * alike, dtype=np.float64)


def is_coarse(grid: MapGrid) -> bool:
    """Whether the land between the surface model's samples is not known."""
    return grid.dsm_gsd_m >= COARSE_M


def unresolved_m(grid: MapGrid) -> float:
    """1-sigma of the land between the samples of a coarse surface model; 0 where they are closer than COARSE_M."""
    return unresolved_of(grid.surface_up_m, grid.gsd_m, grid.dsm_gsd_m) if is_coarse(grid) else 0.0


def unresolved_of(surface_up_m: NDArray[np.float32], gsd_m: float, dsm_gsd_m: float) -> float:
    """The same of a window's heights (H, W), whose pixels are so large, by a surface model with samples so far apart."""
    if dsm_gsd_m < COARSE_M:
        return 0.0
    rows, cols = np.indices(surface_up_m.shape).reshape(2, -1)
    design, heights = design_of(rows, cols), surface_up_m.ravel().astype(np.float64)
    rest = heights - design @ plane_through(design, heights)
    return float(np.std(rest)) * min(1.0, UNRESOLVED * dsm_gsd_m / (gsd_m * math.sqrt(rows.size)))


def unresolved_parts(at_ne_m: FloatArray, sigma_m: float, dsm_gsd_m: float) -> tuple[float, float, float]:
    """1-sigma of the level (m), of the slope on its worse axis (rad) and of what is left (m) that such land has at (N, 2) places.

    N of three or more, not on one line; fewer and those have all of it in the level.
    """
    some = at_ne_m[:: -(-len(at_ne_m) // MOST_PLACES)] if len(at_ne_m) else at_ne_m
    off = some - some.mean(0) if len(some) else some
    design = np.column_stack([np.ones(len(off)), off])
    if sigma_m <= 0 or len(some) < 3 or np.linalg.cond(design.T @ design) > 1e9:
        return sigma_m, 0.0, 0.0
    apart_m = np.hypot(*(some[:, None] - some[None]).transpose(2, 0, 1))
    C = sigma_m**2 * np.exp(-apart_m / max(ALIKE_M, dsm_gsd_m))
    fit = np.linalg.pinv(design)
    plane, rest = fit @ C @ fit.T, np.eye(len(some)) - design @ fit
    slope = math.sqrt(float(np.linalg.eigvalsh(plane[1:, 1:])[-1]))
    return math.sqrt(float(plane[0, 0])), slope, math.sqrt(float(np.trace(rest @ C @ rest.T)) / len(some))


def standing_m(grid: MapGrid, at_px: FloatArray, side_px: float) -> FloatArray:
    """(N,) mean height of what stands on the ground over squares of a side about pixels (N, 2)."""
    above, step = above_opening(grid.surface_up_m, grid.gsd_m)
    height, width = above.shape
    mean = cv2.blur(above, (max(1, math.ceil(side_px / step)),) * 2, borderType=cv2.BORDER_REPLICATE)
    col, row = np.clip(np.rint((at_px + 0.5) / step - 0.5).astype(int), 0, (width - 1, height - 1)).T
    return np.asarray(mean[row, col], dtype=np.float64)


def above_opening(surface_up_m: NDArray[np.float32], gsd_m: float) -> tuple[NDArray[np.float32], int]:
    """Heights (h, w) of what stands on the ground, one for every square of so many pixels of a surface model (H, W)."""
    step = max(1, round(STEP_M / gsd_m))
    height, width = (max(1, n // step) for n in surface_up_m.shape)
    up = cv2.resize(surface_up_m[: height * step, : width * step], (width, height), interpolation=cv2.INTER_AREA)
    reach = min(max(1, round(OPENED_M / 2 / (step * gsd_m))), height - 1, width - 1)
    beyond = np.pad(up, reach, mode="reflect", reflect_type="odd")  # a slope goes on beyond the window
    opened = cv2.morphologyEx(beyond, cv2.MORPH_OPEN, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    return np.asarray(up - opened[reach : reach + height, reach : reach + width], dtype=np.float32), step
