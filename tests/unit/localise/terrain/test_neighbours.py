"""Places beside each other that fit one line of soundings: the likeliest is taken, and the others are in what is claimed."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain.base import Kind, Soundings, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.fitting import fitting_of
from visloc_companion.localise.terrain.neighbours import of_neighbours
from visloc_companion.localise.terrain.refine import N_UNKNOWNS, Fitting, refine
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.types import FloatArray

CELL_M, HALF_M, HIGH_M, ASIDE_M = 10.0, 1000.0, 600.0, 40.0


def ridges(ne: FloatArray, differing_m: float) -> FloatArray:
    """Hills that are nearly the same 40 m to the east, but for waves of a height that are not."""
    north, east = ne[..., 0], ne[..., 1]
    same = 250 + 30 * np.sin(north / 90) + 6 * np.sin(north / 47 + 2 * np.pi * east / ASIDE_M)
    return np.asarray(same + differing_m * np.sin(north / 33 + 2 * np.pi * east / 110))


def fitting(differing_m: float) -> Fitting:
    """A line of 1.5 km to the north that ends at the prior's place, which is right."""
    n = round(2 * HALF_M / CELL_M) + 1
    v, u = np.mgrid[0:n, 0:n] * CELL_M - HALF_M
    heights = ridges(np.stack([v, u], -1), differing_m).astype(np.float32)
    model = ElevationMap(heights, np.array([[0.0, CELL_M, -HALF_M], [CELL_M, 0.0, -HALF_M]]), 1.0)
    north = np.arange(-1500.0, 0.0, 10.0) + 750
    ne = np.column_stack([north, np.zeros(len(north))])
    up = ridges(ne, differing_m) - HIGH_M
    at = np.array([750.0, 0.0])
    seen = Soundings(9, np.column_stack([ne - at, up]), (750 - north) / 50, 0.4, Kind.PROFILE, np.column_stack([0 * ne, up]))
    prior = TerrainPrior((750.0, 0.0), ((1e4, 0.0), (0.0, 1e4)), HIGH_M, 5.0, sigma_drift_mps=0.02)
    terrain = model.window((0.0, 0.0), (HALF_M - 20, HALF_M - 20), CELL_M)
    return fitting_of(terrain, seen, prior, model, TerrainSettings())


def aside() -> FloatArray:
    start = np.zeros(N_UNKNOWNS)
    start[1] = ASIDE_M
    return start


def test_the_likelier_place_beside_the_one_that_a_fit_ended_at_is_taken() -> None:
    line = fitting(differing_m=4.0)
    ended = refine(line, aside())
    assert ended.converged
    assert abs(ended.unknowns[1]) > 25
    best, _ = of_neighbours(line, ended)
    assert best.log_likelihood > ended.log_likelihood
    assert np.hypot(*best.unknowns[:2]) < 3


def test_places_as_likely_are_in_the_claim() -> None:
    line = fitting(differing_m=0.0)
    best, spread = of_neighbours(line, refine(line, aside()))
    assert abs(best.unknowns[1]) % ASIDE_M == pytest.approx(0, abs=3) or abs(best.unknowns[1]) % ASIDE_M > ASIDE_M - 3
    assert np.sqrt(spread[1, 1]) > 0.5 * ASIDE_M
    assert np.sqrt(spread[0, 0]) < 5
