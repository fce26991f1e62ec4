"""What the refinement of soundings rests on: expected noise, blocks of ground, and how many soundings are independent."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.localise.terrain.base import Soundings, TerrainPrior
from visloc_companion.localise.terrain.cells import cells_of
from visloc_companion.localise.terrain.elevation import ElevationMap, Terrain
from visloc_companion.localise.terrain.noise import HeightNoise
from visloc_companion.localise.terrain.refine import Fitting
from visloc_companion.localise.terrain.settings import TerrainSettings

BLOCKS = 20.0
SMALLEST, LARGEST = 1.5, 4.5
"""Side of a block of the cluster-robust covariance, in correlation lengths: as large as leaves so many blocks, for the errors of
elevation models have long waves as well, and these are what misleads on even ground."""


def fitting_of(
    terrain: Terrain, thinned: Soundings, prior: TerrainPrior, elevation: ElevationMap, settings: TerrainSettings
) -> Fitting:
    """What the refinement of thinned soundings needs."""
    noise = HeightNoise(math.hypot(elevation.sigma_m, thinned.sigma_m))
    false_slope = settings.false_slope * elevation.sigma_m / settings.correlation_m
    share = independent_share(thinned, settings)
    side = math.sqrt(share * len(thinned.points_m) / BLOCKS)
    block = settings.correlation_m * min(max(side, SMALLEST), LARGEST)
    return Fitting(terrain, thinned, prior, noise, block, share, false_slope, cells_of(thinned.points_m[:, :2]))


def independent_share(thinned: Soundings, settings: TerrainSettings) -> float:
    """Patches of correlated ground that the soundings touch, over the soundings."""
    cells = np.floor(thinned.points_m[:, :2] / settings.correlation_m).astype(np.int64)
    return min(1.0, len(np.unique(cells, axis=0)) / len(cells))
