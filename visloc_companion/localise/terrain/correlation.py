"""How much soundings tell whose errors are alike nearby: the variance of sums over them.

Errors of an elevation model have short waves and long ones. Where slopes have long waves, too (whole hillsides), the long ones do
not average out over a stretch; where the ground is rough they do. A count of independent soundings knows no such difference.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.types import FloatArray

LENGTHS_M = (60.0, 400.0)
"""Lengths over which the model's errors are alike (autocorrelation 1/e there), each with an equal share of their variance."""
MOST = 700


def alike(ne_m: FloatArray) -> FloatArray:
    """(N, N) correlation of the model's errors at (N, 2) places, metres."""
    squared = np.square(ne_m[:, None] - ne_m[None]).sum(-1)
    return np.asarray(sum(np.exp(-squared / length**2) for length in LENGTHS_M) / len(LENGTHS_M), dtype=np.float64)


def correlated_outer(weighted: FloatArray, ne_m: FloatArray) -> FloatArray:
    """(K, K) covariance of the sum of (N, K) weights times errors of unit variance at (N, 2) places, metres."""
    every = max(1, math.ceil(len(weighted) / MOST))
    some = weighted[::every]
    scale = (len(weighted) / max(len(some), 1)) ** 2
    return np.asarray(some.T @ alike(ne_m[::every]) @ some * scale, dtype=np.float64)
