"""The bare terrain of the procedural landscape: fractal relief with the river's valley and level water."""

from __future__ import annotations

import cv2
import numpy as np

from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_noise import Raster, fractal_noise, rng_of
from visloc_companion.sim.land.landscape_plan import Plan

BASE_H_AMSL_M = 462.0
COARSE_M = 4.0


def terrain(seed: int, grid: Grid, plan: Plan) -> Raster:
    """(H, W) ground heights above sea level, metres; smooth at the scale of fields, level along the water."""
    size = int(np.ceil(plan.size_m / COARSE_M)) + 1
    coarse = Grid(size, COARSE_M)
    relief = fractal_noise(rng_of(seed, "terrain"), size, 620 / COARSE_M, 5, 0.42) * np.float32(13)
    river, lake = coarse.blank(), coarse.blank()
    coarse.draw(river, plan.river_m, 16.0)
    coarse.fill(lake, plan.lake_m, 255)
    valley = np.exp(-((_distance(river) / 210) ** 2))
    floor = cv2.GaussianBlur(relief, (0, 0), 90 / COARSE_M) * np.float32(0.3) - 14
    relief = relief + (floor - relief) * valley
    to_lake = _distance(lake)
    around = (to_lake < 12) if lake.any() else np.zeros_like(to_lake, bool)
    if around.any():
        level = np.float32(relief[around].min() - 0.8)
        relief = relief + (level - relief) * np.exp(-((to_lake / 55) ** 2))
    relief -= np.float32(2.2) * np.exp(-((_distance(river) / 9) ** 2))
    scale = grid.gsd_m / COARSE_M
    half = 0.5 * scale - 0.5
    to_coarse = np.array([[scale, 0, half], [0, scale, half]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    fine = cv2.warpAffine(
        relief.astype(np.float32), to_coarse, (grid.size_px, grid.size_px), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(fine + np.float32(BASE_H_AMSL_M), dtype=np.float32)


def _distance(mask: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> Raster:
    if not mask.any():
        return np.full(mask.shape, 1e6, np.float32)
    return np.asarray(cv2.distanceTransform(np.where(mask > 0, 0, 255).astype(np.uint8), cv2.DIST_L2, 5) * COARSE_M, np.float32)
