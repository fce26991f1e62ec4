"""Snow over the procedural landscape: it hides what it lies on, and the wind gives it a relief of its own."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.sim.land.landscape_noise import Raster, fractal_noise, rng_of, smooth_noise
from visloc_companion.sim.land.landscape_stamps import Objects
from visloc_companion.sim.land.season import SnowCover
from visloc_companion.types import Image

BAND_ROWS = 400
PATCH_M = 6.0
"""How far apart the places lie where the snow is a little thinner."""
SMOOTH_M = 3.0
"""Snow fills what is narrower (1-sigma)."""
DRIFT_OCTAVES, DRIFT_GAIN = 4, 0.6


def snowed(seed: int, albedo: Image, objects: Objects, conifer: NDArray[np.bool_], snow: SnowCover, gsd_m: float) -> Image:
    """Albedo (H, W, 3) with snow on it. `conifer` tells of each tree whether it has needles."""
    size = albedo.shape[0]
    patches = fractal_noise(rng_of(seed, "snow patches"), size, PATCH_M / gsd_m, 3)
    clumps = smooth_noise(rng_of(seed, "snow clumps"), size, snow.clump_m / gsd_m)
    rng = rng_of(seed, "snow grain")
    on_trees = np.where(conifer, snow.conifer, snow.bare).astype(np.float32)
    result = np.empty_like(albedo)
    for top in range(0, size, BAND_ROWS):
        band = slice(top, top + BAND_ROWS)
        tree = objects.tree[band]
        is_tree = tree >= 0
        share = snow.ground + np.float32(1 - snow.ground) * patches[band]
        share = np.where(is_tree, on_trees[np.maximum(tree, 0)] + snow.clump * clumps[band], share)
        share = np.clip(np.where(objects.roof[band] > 0, snow.roofs, share), 0, 1)[:, :, None]
        lumps = np.where(is_tree, 0.6 + objects.shade[band].astype(np.float32) * np.float32(0.4 / 128), 1)[:, :, None]
        bright = 1 + np.float32(snow.grain) * rng.standard_normal((*tree.shape, 1), dtype=np.float32)
        white = np.array(snow.color, np.float32) * bright * lumps
        result[band] = np.clip(albedo[band] * (1 - share) + white * share, 0, 255)
    return result


def drifted(seed: int, ground_m: Raster, snow: SnowCover, gsd_m: float) -> Raster:
    """Heights (H, W) of the ground evened out and with drifts."""
    evened = cv2.GaussianBlur(ground_m, (0, 0), SMOOTH_M / gsd_m)
    relief = fractal_noise(rng_of(seed, "snow drifts"), ground_m.shape[0], snow.drift_cell_m / gsd_m, DRIFT_OCTAVES, DRIFT_GAIN)
    return np.asarray(evened + np.float32(snow.drift_m) * relief, dtype=np.float32)
