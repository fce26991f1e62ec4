"""Vision against GNSS over time: a sequential test that finds a slow drag and leaves a constant offset alone.

Differences (GNSS minus vision, NED metres) are averaged over blocks of one second, because the errors of both are correlated
over shorter times. Each block, less the learned bias and divided by its sigma, is projected on eight directions; in each a
one-sided CUSUM (Page 1954) sums what exceeds `suspect_sigma`, times `suspect_sigma`. So large a slack is deliberate: GNSS and
map errors wander for minutes, and excursions of 2 to 3 sigma for ten seconds are healthy. Compared with half the slack and a
threshold three times as high it finds a drag of 1 m/s as early (median 11 m) with a hundredth of the false alarms
(tests/statistics). The bias (satellite orbits and clocks, the map's registration) is a Kalman random walk about zero,
learned only while GNSS is trusted, and bounded, so that a drag cannot hide in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import Vec2

BLOCK_S = 1.0
ALMOST = 0.95
"""A block may be this much shorter, for frames that jitter about one a second."""
STALE_S = 3.0
MAX_BIAS_M = 4.0
BIAS_SIGMA_M = 2.0
BIAS_WALK_M_PER_SQRT_S = 0.02
CLIP_SIGMA = 6.0
"""One block counts at most this much, so that a single wrong fix never decides."""
N_DIRECTIONS = 8
SUM_LIMIT = 2.0
"""The sums are held at this many thresholds, so that they can come down again."""


@dataclass(frozen=True, slots=True)
class BlockResult:
    """One finished block: distance from the bias in sigma, and the largest CUSUM."""

    t_ns: int
    distance_sigma: float
    largest_sum: float


class DriftTest:
    """The sequential test; `add` answers when a block is finished."""

    def __init__(self, suspect_sigma: float, threshold: float) -> None:
        self._clip = max(CLIP_SIGMA, 2 * suspect_sigma)
        self._suspect_sigma = suspect_sigma
        self._limit = SUM_LIMIT * threshold
        self._sums = [0.0] * N_DIRECTIONS
        self._bias: Vec2 = (0.0, 0.0)
        self._bias_var_m2 = BIAS_SIGMA_M**2
        self._finished_ns: int | None = None
        self._clear_block()

    @property
    def bias_m(self) -> Vec2:
        """The learned constant part of the difference, north and east."""
        return self._bias

    @property
    def largest_sum(self) -> float:
        """The largest of the eight sums."""
        return max(self._sums)

    def _clear_block(self) -> None:
        self._n = 0
        self._north, self._east, self._white_var = 0.0, 0.0, 0.0

    def add(self, t_ns: int, difference_ne_m: Vec2, white_var_m2: float, common_var_m2: float, learn: bool) -> BlockResult | None:
        """Take one comparison; `white_var_m2` averages out within a block (the fix's own), `common_var_m2` does not."""
        since_s = math.inf if self._finished_ns is None else (t_ns - self._finished_ns) * 1e-9
        if since_s > STALE_S:
            self._clear_block()
        self._n += 1
        self._north += difference_ne_m[0]
        self._east += difference_ne_m[1]
        self._white_var += white_var_m2
        if since_s < ALMOST * BLOCK_S:
            return None
        mean = (self._north / self._n, self._east / self._n)
        result = self._finish(t_ns, mean, self._white_var / self._n**2 + common_var_m2, learn)
        self._clear_block()
        self._finished_ns = t_ns
        return result

    def _finish(self, t_ns: int, mean_ne_m: Vec2, var_m2: float, learn: bool) -> BlockResult:
        self._bias_var_m2 += BIAS_WALK_M_PER_SQRT_S**2 * BLOCK_S
        sigma = math.sqrt(var_m2 + self._bias_var_m2)
        north, east = (mean_ne_m[0] - self._bias[0]) / sigma, (mean_ne_m[1] - self._bias[1]) / sigma
        distance = math.hypot(north, east)
        scale = min(1.0, self._clip / distance) if distance > 0 else 1.0
        for k in range(N_DIRECTIONS):
            angle = 2 * math.pi * k / N_DIRECTIONS
            along = scale * (north * math.cos(angle) + east * math.sin(angle))
            excess = self._suspect_sigma * (along - self._suspect_sigma)
            self._sums[k] = min(self._limit, max(0.0, self._sums[k] + excess))
        if learn and distance < self._suspect_sigma:
            self._learn(mean_ne_m, var_m2)
        return BlockResult(t_ns, distance, self.largest_sum)

    def _learn(self, mean_ne_m: Vec2, var_m2: float) -> None:
        gain = self._bias_var_m2 / (self._bias_var_m2 + var_m2)
        north = self._bias[0] + gain * (mean_ne_m[0] - self._bias[0])
        east = self._bias[1] + gain * (mean_ne_m[1] - self._bias[1])
        length = math.hypot(north, east)
        scale = min(1.0, MAX_BIAS_M / length) if length > 0 else 1.0
        self._bias = (scale * north, scale * east)
        self._bias_var_m2 *= 1 - gain
