"""What a stretch of soundings can tell before it is matched: whether it is long enough yet."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.localise.terrain import refine as fine
from visloc_companion.localise.terrain.base import Soundings, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.fitting import fitting_of
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.thin import MOST_POINTS, lowest

FEW = 800
"""Soundings that suffice to judge by."""


def expected_sigma_m(soundings: Soundings, prior: TerrainPrior, elevation: ElevationMap, settings: TerrainSettings) -> float:
    """1-sigma of the worse horizontal axis that a fix at the prior's place would claim; infinite where the model is unknown.

    Under a height that does not walk: more of a stretch is no remedy for that, while it walks on and the dead reckoning drifts.
    """
    thinned = lowest(soundings, settings.thin_cell_m, min(FEW, MOST_POINTS[soundings.kind]))
    half = np.abs(thinned.points_m[:, :2]).max(0) + 4 * elevation.cell_m
    terrain = elevation.window(prior.p_ne_m, (float(half[0]), float(half[1])), elevation.cell_m)
    if not terrain.known.any():
        return math.inf
    fitting = fitting_of(terrain, thinned, replace(prior, sigma_h_walk=0.0), elevation, settings)
    covariance = fine.expected_covariance(fitting, np.zeros(fine.N_UNKNOWNS))
    claimed = covariance[:2, :2] + np.eye(2) * elevation.sigma_ne_m**2
    return math.sqrt(max(float(np.linalg.eigvalsh(claimed)[-1]), 0.0))
