"""How a measured height differs from the elevation model: a mixture that knows that vegetation only ever stands above ground.

    p(d) = (1 - v - o) N(d; 0, sigma)  +  v Exp(d; mean) * N(0, sigma)  +  o / RANGE_M

d is measured minus model: ground seen, something standing on it (exponentially modified Gaussian, Grushka 1972), or anything.
Its logarithm is a robust loss with a short arm below and a long one above, so that what stands on the ground hardly lifts it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr  # type: ignore[import-untyped]

from visloc_companion.types import FloatArray

RANGE_M = 200.0
"""Over which outliers are spread."""
TABLE_M = 120.0
STEP_SIGMAS = 0.05
OVER_MEAN_M = (3.0, 15.0)
"""Bounds of the mean height of what stands on the ground."""
STANDING = (0.02, 0.7)
"""Bounds of its share."""


@dataclass(frozen=True, slots=True)
class HeightNoise:
    """1-sigma of ground heights, share and mean height of what stands on it, share of outliers."""

    sigma_m: float
    standing: float = 0.3
    standing_mean_m: float = 8.0
    outliers: float = 0.02


class Parts(NamedTuple):
    """Of (N,) differences: log density, its derivative (1/m), and the probability of being ground."""

    log_density: FloatArray
    score: FloatArray
    ground: FloatArray


def parts(noise: HeightNoise, difference_m: FloatArray) -> Parts:
    """From a table of the density (linear between entries, constant beyond the table)."""
    at, log_density, score, ground = _table(noise)
    return Parts(*(np.interp(difference_m, at, values) for values in (log_density, score, ground)))


def expected_log_density(noise: HeightNoise) -> float:
    """Mean log density of differences that follow the mixture."""
    _, log_density, _, _ = _table(noise)
    density = np.exp(log_density)
    return float((density * log_density).sum() / density.sum())


def refitted(noise: HeightNoise, difference_m: FloatArray, bounds_m: tuple[float, float], rounds: int = 3) -> HeightNoise:
    """Sigma (within bounds), share and mean height of what stands on the ground by expectation maximisation."""
    for _ in range(rounds):
        ground, standing = _memberships(noise, difference_m)
        n_ground, n_standing = float(ground.sum()), float(standing.sum())
        if n_ground + n_standing < 5:
            return noise
        sigma = math.sqrt(float(ground @ np.square(difference_m)) / max(n_ground, 1.0))
        mean = float(standing @ np.maximum(difference_m, 0)) / max(n_standing, 1.0)
        share = (1 - noise.outliers) * n_standing / (n_ground + n_standing)
        noise = replace(
            noise,
            sigma_m=min(max(sigma, bounds_m[0]), bounds_m[1]),
            standing=min(max(share, STANDING[0]), STANDING[1]),
            standing_mean_m=min(max(mean, OVER_MEAN_M[0]), OVER_MEAN_M[1]),
        )
    return noise


def _memberships(noise: HeightNoise, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    of_ground, of_standing, of_outliers = _densities(noise, d)
    total = of_ground + of_standing + of_outliers
    return of_ground / total, of_standing / total


def _densities(noise: HeightNoise, d: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    s, m = noise.sigma_m, noise.standing_mean_m
    ground: FloatArray = (1 - noise.standing - noise.outliers) * np.exp(-0.5 * np.square(d / s)) / (s * math.sqrt(2 * math.pi))
    standing: FloatArray = noise.standing / m * np.exp(s * s / (2 * m * m) - d / m + log_ndtr(d / s - s / m))
    return ground, standing, np.full(d.shape, max(noise.outliers, 1e-12) / RANGE_M)


@lru_cache(maxsize=64)
def _table(noise: HeightNoise) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    step = STEP_SIGMAS * noise.sigma_m
    n = math.ceil(TABLE_M / step)
    at = np.asarray(np.arange(-n, n + 1) * step, dtype=np.float64)
    ground, standing, outliers = _densities(noise, at)
    total = ground + standing + outliers
    log_density = np.log(total)
    return at, log_density, np.gradient(log_density, step), ground / total
