"""Posterior over positions from a score volume: mean, covariance, entropy and all modes.

    p(s) = exp(score(s) / T) / sum over the allowed s'

The temperature T is fitted by maximum likelihood on cases whose true position is known (temperature scaling, Guo et al. 2017):
then p is calibrated in the sense of the logarithmic score, and the mass outside the best mode says how often the best mode is
not the right place. Scores of a template scatter by about one over its side in pixels, and so does the temperature: gradient
features of two years of farmland give T = 1.06, 0.99 and 1.07 over the side of 90, 64 and 48 px (80 cases each).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from visloc_companion.errors import CasesError
from visloc_companion.localise.search import NO_SCORE, ScoreVolume
from visloc_companion.types import FloatArray

Mask = NDArray[np.bool_]
MODE_RADIUS_PX = 3
MIN_MODE_MASS = 1e-3
NEGLIGIBLE = 1e-9
"""Positions less likely than this share of the likeliest are left out of the search for modes."""
COLDEST, HOTTEST = 1e-4, 1e2


class Mode(NamedTuple):
    """A local maximum of the posterior: window pixel (u, v), hypothesis there, and the probability of all that leads up to it."""

    u_px: int
    v_px: int
    hypothesis: int
    mass: float


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Moments in window pixels: `mean_px` (u, v), `cov_px2` (2, 2); `entropy` in nats; `modes` by falling mass.

    The covariance holds the 1/12 px² of a position within its pixel. Without any allowed position with a score: no modes, NaN
    moments, zero entropy.
    """

    mean_px: FloatArray
    cov_px2: FloatArray
    entropy: float
    modes: tuple[Mode, ...]

    @property
    def ambiguity(self) -> float:
        """Probability that the position is not that of the best mode."""
        return 1 - self.modes[0].mass if self.modes else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class KnownPosition:
    """A score volume with the allowed positions and the true position (u, v) in window pixels.

    `unit`: the temperature is fitted as a multiple of it, so that samples of unlike footprints share one factor.
    """

    volume: ScoreVolume
    allowed: Mask
    true_px: tuple[float, float]
    unit: float = 1.0


def posterior(volume: ScoreVolume, allowed: Mask, temperature: float) -> Posterior:
    """The posterior over the allowed positions (H, W) of a volume that have a score, equally likely beforehand."""
    rows, cols = np.nonzero(allowed & (volume.score > NO_SCORE))
    if not len(rows):
        return Posterior(np.full(2, np.nan), np.full((2, 2), np.nan), 0.0, ())
    scores = volume.score[rows, cols].astype(np.float64) / temperature
    p = np.exp(scores - scores.max())
    p /= p.sum()
    uv = np.column_stack([cols + volume.origin_px[0], rows + volume.origin_px[1]]).astype(np.float64)
    mean = p @ uv
    cov = (uv - mean).T @ ((uv - mean) * p[:, None]) + np.eye(2) / 12
    entropy = -float(np.sum(p * np.log(np.maximum(p, 1e-300))))
    likely = p >= NEGLIGIBLE * p.max()
    return Posterior(mean, cov, entropy, _modes(volume, rows[likely], cols[likely], p[likely]))


def fit_temperature(samples: Sequence[KnownPosition], radius_px: float = 0.75) -> float:
    """The temperature, in the samples' units, under which the true positions are likeliest.

    The likelihood of a sample is the mass within `radius_px` of its true position: how far map and truth disagree, and at least
    0.71 px so that a pixel is always within (a larger one than that disagreement gives too low a temperature). A sample whose
    true position is not among the allowed ones says nothing about the temperature: CasesError, as for no samples.
    """
    if not samples:
        raise CasesError("no samples", where="fit_temperature", remedy="give score volumes whose true position is known")
    parts = [_near_and_all(sample, radius_px) for sample in samples]

    def cost(log_temperature: float) -> float:
        t = math.exp(log_temperature)
        return sum(log_sum(every / t) - log_sum(near / t) for near, every in parts)

    low, high = math.log(COLDEST), math.log(HOTTEST)
    grid = np.linspace(low, high, 40)
    at = int(np.argmin([cost(float(x)) for x in grid]))
    return math.exp(_golden(cost, float(grid[max(at - 1, 0)]), float(grid[min(at + 1, len(grid) - 1)])))


def _modes(volume: ScoreVolume, rows: NDArray[np.int64], cols: NDArray[np.int64], p: FloatArray) -> tuple[Mode, ...]:
    """Every position belongs to the mode that it reaches by steps to the likeliest position within MODE_RADIUS_PX."""
    order = np.argsort(p, kind="stable")
    rank = np.zeros(volume.score.shape, np.int64)
    rank[rows[order], cols[order]] = np.arange(1, len(p) + 1)
    highest = _highest_near(_highest_near(rank).T).T[rows, cols]
    leader = order[highest - 1]
    while not np.array_equal(beyond := leader[leader], leader):
        leader = beyond
    mass = np.bincount(leader, p, len(p))
    tops = np.argsort(-mass, kind="stable")[: int(np.count_nonzero(mass >= MIN_MODE_MASS))].tolist()
    u0, v0 = volume.origin_px
    return tuple(
        Mode(int(cols[k]) + u0, int(rows[k]) + v0, int(volume.hypothesis[rows[k], cols[k]]), float(mass[k])) for k in tops
    )


def _highest_near(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """The greatest of each value (H, W) and those within MODE_RADIUS_PX of it in its column."""
    highest = values.copy()
    for k in range(1, MODE_RADIUS_PX + 1):
        np.maximum(highest[k:], values[:-k], out=highest[k:])
        np.maximum(highest[:-k], values[k:], out=highest[:-k])
    return highest


def _near_and_all(sample: KnownPosition, radius_px: float) -> tuple[FloatArray, FloatArray]:
    """Scores near the true position, and all."""
    rows, cols = np.nonzero(sample.allowed & (sample.volume.score > NO_SCORE))
    scores = sample.volume.score[rows, cols].astype(np.float64) / sample.unit
    u, v = (true - origin for true, origin in zip(sample.true_px, sample.volume.origin_px, strict=True))
    near = np.hypot(cols - u, rows - v) <= radius_px
    if not near.any():
        what = f"the true position {sample.true_px} is not among the allowed positions that have a score"
        raise CasesError(what, where="fit_temperature", remedy="leave out cases whose prior excludes the truth")
    return scores[near], scores


def log_sum(values: FloatArray) -> float:
    """Log of the sum of what these are the logs of, at least one of them finite."""
    highest = float(values.max())
    return highest + math.log(float(np.exp(values - highest).sum()))


def _golden(cost: Callable[[float], float], low: float, high: float, steps: int = 24) -> float:
    """Golden-section search for the least cost between two bounds."""
    ratio = (math.sqrt(5) - 1) / 2
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    cost_a, cost_b = cost(a), cost(b)
    for _ in range(steps):
        if cost_a < cost_b:
            high, b, cost_b = b, a, cost_a
            a = high - ratio * (high - low)
            cost_a = cost(a)
        else:
            low, a, cost_a = a, b, cost_b
            b = low + ratio * (high - low)
            cost_b = cost(b)
    return (low + high) / 2
