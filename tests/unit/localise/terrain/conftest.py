"""Ground made of waves, elevation models of it, and soundings of it from above."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.terrain.base import Kind, Soundings, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.types import FloatArray, Vec2

Ground = Callable[[FloatArray], FloatArray]
CELL_M = 20.0
TRUE_NE = (63.0, -41.0)
TRUE_H = 700.0


def waves(height_m: float, seed: int = 1, n: int = 40) -> Ground:
    """A smooth random surface of a 1-sigma height, wavelengths 200 to 2000 m."""
    rng = np.random.default_rng(seed)
    length, direction, phase = rng.uniform(200, 2000, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0, 2 * np.pi, n)
    k = 2 * np.pi / length[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    weight = length / np.sqrt(np.square(length).mean()) * height_m * np.sqrt(2 / n)
    return lambda ne: 250 + np.sin(ne @ k.T + phase) @ weight


def elevation(ground: Ground, half_m: float = 2000.0, sigma_m: float = 1.0, noise_m: float = 0.0) -> ElevationMap:
    """North-up, first row northernmost, as a GeoTIFF has it."""
    n = round(2 * half_m / CELL_M) + 1
    T_ne_pix = np.array([[0.0, -CELL_M, half_m], [CELL_M, 0.0, -half_m]])
    v, u = np.mgrid[0:n, 0:n]
    ne = np.stack([half_m - v * CELL_M, u * CELL_M - half_m], -1).reshape(-1, 2).astype(float)
    heights = ground(ne).reshape(n, n) + np.random.default_rng(5).normal(0, 1, (n, n)) * noise_m
    return ElevationMap(heights.astype(np.float32), T_ne_pix, sigma_m)


def patch(
    ground: Ground, seed: int = 2, half_m: float = 300.0, trees: float = 0.0, tree_m: float = 15.0, at: Vec2 = TRUE_NE
) -> Soundings:
    """2500 points about the true place, a share of them on trees of up to a height."""
    rng = np.random.default_rng(seed)
    ne = rng.uniform(-half_m, half_m, (2500, 2))
    up = ground(ne + np.array(at)) - TRUE_H + rng.normal(0, 0.3, len(ne))
    stand = np.sin(ne[:, 0] / 60) * np.sin(ne[:, 1] / 45) > 0
    on_tree = stand & (rng.random(len(ne)) < 2 * trees)
    up = up + np.where(on_tree, rng.uniform(0.5, 1, len(ne)) * tree_m, 0)
    return Soundings(9, np.column_stack([ne, up]), (300 - ne[:, 0]) / 50, 0.4)


def profile(ground: Ground, length_m: float = 3000.0, drift_mps: Vec2 = (0.0, 0.0)) -> Soundings:
    """A line of soundings to the north that ends at the true place, put together with a velocity error."""
    age = np.arange(0, length_m, 5.0)[::-1] / 50
    ne = np.column_stack([-50 * age, np.zeros(len(age))])
    up = ground(ne + np.array(TRUE_NE)) - TRUE_H + np.random.default_rng(3).normal(0, 0.3, len(age))
    return Soundings(9, np.column_stack([ne + age[:, None] * np.array(drift_mps), up]), age, 0.4, Kind.PROFILE)


def prior(sigma_m: float = 50.0, h_off_m: float = 0.0, at: Vec2 = (0.0, 0.0), sigma_drift_mps: float = 0.05) -> TerrainPrior:
    return TerrainPrior(at, ((sigma_m**2, 0.0), (0.0, sigma_m**2)), TRUE_H + h_off_m, 8.0, sigma_drift_mps=sigma_drift_mps)


@pytest.fixture(scope="session")
def world() -> SimpleNamespace:
    """The helpers of this file."""
    return SimpleNamespace(
        waves=waves, elevation=elevation, patch=patch, profile=profile, prior=prior, true_ne=TRUE_NE, true_h=TRUE_H
    )
