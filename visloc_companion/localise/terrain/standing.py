"""Which soundings are ground, where what stands there is about as tall as what stands nearby.

    p(d) = (1 - v - o) N(d; 0, sigma)  +  sum over k of v_k U(d; 0, TALL_M[k]) * N(0, sigma)  +  o / RANGE_M

is the mixture of noise.py with shares of each place's own, and with heights of any density that falls with height (a mixture of
uniforms from zero on; Khinchin 1938). With one share for all of a stretch, of anything up to TALLEST_M, crowns of 3 to 10 m are
less likely than a ground that is rough all over: where crowns are low and gaps are few they were taken for it. The shares are
those of a neighbourhood, by expectation maximisation with weights that fall with distance (local likelihood; Tibshirani & Hastie
1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr  # type: ignore[import-untyped]

from visloc_companion.localise.terrain.cells import Cells
from visloc_companion.localise.terrain.noise import RANGE_M, STANDING, HeightNoise, Stated
from visloc_companion.localise.terrain.tallest import TALLEST_M
from visloc_companion.types import FloatArray

TALL_M = (TALLEST_M / 4, TALLEST_M / 2, TALLEST_M)
OF_ALL = 5.0
"""So many soundings the shares of the whole stretch count as in a neighbourhood."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """`sigma_m` of ground heights, and `shares` (K, M) of what stands on each cell, by TALL_M; `outliers` as in HeightNoise."""

    sigma_m: float
    shares: FloatArray
    outliers: float

    def noise(self) -> HeightNoise:
        """With one share for all."""
        return HeightNoise(self.sigma_m, float(np.clip(self.shares.sum(0).mean(), *STANDING)), self.outliers)


@dataclass(frozen=True, slots=True, eq=False)
class Apart:
    """Probabilities of being ground (N,) and of standing on it (K, N), and the log density (N,)."""

    ground: FloatArray
    standing: FloatArray
    log_density: FloatArray


def at_first(noise: HeightNoise, cells: Cells) -> Standing:
    """Shares alike everywhere."""
    shares = np.full((len(TALL_M), len(cells.at_m)), noise.standing / len(TALL_M))
    return Standing(noise.sigma_m, shares, noise.outliers)


def told_apart(standing: Standing, cells: Cells, difference_m: FloatArray) -> Apart:
    """What (N,) differences, measured minus model, are likely to be."""
    sigma, shares = standing.sigma_m, standing.shares[:, cells.of]
    density = np.exp(-0.5 * np.square(difference_m / sigma)) / (sigma * math.sqrt(2 * math.pi))
    ground = (1 - shares.sum(0) - standing.outliers) * density
    above = ndtr(difference_m / sigma)
    uniform = np.array([np.maximum(above - ndtr((difference_m - tall) / sigma), 0) / tall for tall in TALL_M])
    stands = shares * uniform
    total = ground + stands.sum(0) + standing.outliers / RANGE_M
    return Apart(ground / total, stands / total, np.log(total))


def refitted(
    standing: Standing,
    cells: Cells,
    difference_m: FloatArray,
    known: NDArray[np.bool_],
    bounds_m: tuple[float, float],
    stated: Stated,
) -> Standing:
    """One round of expectation maximisation: shares, and sigma within bounds."""
    apart = told_apart(standing, cells, difference_m)
    ground = apart.ground * known
    standing_sums = cells.sums((apart.standing * known).T).T
    everything = cells.sums(ground) + standing_sums.sum(0)
    of_all = standing_sums.sum(1) / max(float(everything.sum()), 1.0)
    nearby = (standing_sums @ cells.near + OF_ALL * of_all[:, None]) / (cells.near @ everything + OF_ALL)
    shares = (1 - standing.outliers) * nearby
    total = shares.sum(0)
    shares *= np.clip(total, *STANDING) / np.maximum(total, 1e-9)
    squared_m2 = float(ground @ np.square(difference_m)) + stated.soundings * stated.sigma_m**2
    sigma = math.sqrt(squared_m2 / max(float(ground.sum()) + stated.soundings, 1.0))
    return Standing(min(max(sigma, bounds_m[0]), bounds_m[1]), shares, standing.outliers)
