"""How a measured height differs from the elevation model: a mixture that knows that vegetation only ever stands above ground.

    p(d) = (1 - v - o) N(d; 0, sigma)  +  v U(d; 0, TALLEST_M) * N(0, sigma)  +  o / RANGE_M

d is measured minus model: ground seen, something of any height standing on it (a uniform, blurred), or anything. Its logarithm is
a robust loss with a cliff below and a plateau above, on which crowns and roofs neither lift nor push.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr  # type: ignore[import-untyped]

from visloc_companion.localise.terrain.tallest import TALLEST_M
from visloc_companion.types import FloatArray

RANGE_M = 200.0
"""Over which outliers are spread."""
TABLE_M = 120.0
STEP_SIGMAS = 0.05
STANDING = (0.02, 0.85)
"""Bounds of the share of what stands on the ground."""


@dataclass(frozen=True, slots=True)
class HeightNoise:
    """1-sigma of ground heights, share of what stands on it, share of outliers."""

    sigma_m: float
    standing: float = 0.3
    outliers: float = 0.02


class Parts(NamedTuple):
    """Of (N,) differences: log density, its derivative (1/m), and the probability of being ground."""

    log_density: FloatArray
    score: FloatArray
    ground: FloatArray


class Stated(NamedTuple):
    """What is stated of the sigma beforehand, which counts as so many soundings of the ground with it."""

    sigma_m: float
    soundings: float

    def log_prior(self, sigma_m: float) -> float:
        """Of another sigma, over that of the stated one (inverse gamma)."""
        squared = (self.sigma_m / sigma_m) ** 2
        return 0.5 * self.soundings * (math.log(squared) + 1 - squared)


NOTHING = Stated(1.0, 0.0)


def parts(noise: HeightNoise, difference_m: FloatArray) -> Parts:
    """From a table of the density (linear between entries, constant beyond the table)."""
    at, log_density, score, ground = _table(noise)
    return Parts(*(np.interp(difference_m, at, values) for values in (log_density, score, ground)))


def expected_log_density(noise: HeightNoise) -> float:
    """Mean log density of differences that follow the mixture."""
    _, log_density, _, _ = _table(noise)
    density = np.exp(log_density)
    return float((density * log_density).sum() / density.sum())


def told(noise: HeightNoise) -> float:
    """What the mixture tells of a level, over what its soundings of the ground would tell if they were known to be ground:
    E[score²] sigma² / P(ground), in (0, 1]. Where crowns begin just above the ground, these are not told apart."""
    _, log_density, score, ground = _table(noise)
    density = np.exp(log_density)
    return float(density @ np.square(score)) * noise.sigma_m**2 / float(density @ ground)


def refitted(
    noise: HeightNoise, difference_m: FloatArray, bounds_m: tuple[float, float], rounds: int = 3, stated: Stated = NOTHING
) -> HeightNoise:
    """Sigma (within bounds) and share of what stands on the ground by expectation maximisation."""
    for _ in range(rounds):
        ground, standing = _memberships(noise, difference_m)
        n_ground, n_standing = float(ground.sum()), float(standing.sum())
        if n_ground + n_standing < 5:
            return noise
        squared_m2 = float(ground @ np.square(difference_m)) + stated.soundings * stated.sigma_m**2
        sigma = math.sqrt(squared_m2 / max(n_ground + stated.soundings, 1.0))
        share = (1 - noise.outliers) * n_standing / (n_ground + n_standing)
        noise = replace(
            noise,
            sigma_m=min(max(sigma, bounds_m[0]), bounds_m[1]),
            standing=min(max(share, STANDING[0]), STANDING[1]),
        )
    return noise


def _memberships(noise: HeightNoise, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    of_ground, of_standing, of_outliers = _densities(noise, d)
    total = of_ground + of_standing + of_outliers
    return of_ground / total, of_standing / total


def _densities(noise: HeightNoise, d: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = noise.sigma_m
    ground: FloatArray = (1 - noise.standing - noise.outliers) * np.exp(-0.5 * np.square(d / s)) / (s * math.sqrt(2 * math.pi))
    standing: FloatArray = noise.standing / TALLEST_M * np.maximum(ndtr(d / s) - ndtr((d - TALLEST_M) / s), 0)
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
