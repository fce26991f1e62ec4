"""What neighbouring fixes get wrong in common: they look at the same ground, with the same error of the attitude.

A fix errs by a part that is new in each and one that lasts; the latter, in 1-sigmas of its own claim, is a pair of the filter's
states, first-order Gauss-Markov over the way that the vehicle has gone (a vehicle that hovers learns nothing from many fixes).
So odometry may carry the position while that error goes by, and a fix that claims little has little of it.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.filter.propagation import FIX_LENS, H_POSITION, LASTING, POSITION
from visloc_companion.types import FloatArray, Vec2

SHARE = 0.6
"""Of the variance that a fix claims, how much lasts (benchmarks/lasting.py)."""
APART = 0.6
"""It has gone by to 1/e after so many heights above the ground."""
LEAST_APART_M = 20.0
LEAST_GONE = 1e-3
"""Of less the mean's variance is rounding."""
BY_SHAPE = frozenset({"structure", "terrain"})
"""Methods that share no more with images than the attitude: what lasts of their own error is another thing, and comes on top."""


def apart_m(height_m: float) -> float:
    """The way after which fixes from a height above the ground look at other ground."""
    return max(LEAST_APART_M, APART * height_m)


def seen(cov_m2: FloatArray, method: str, per_focal_ne_m: Vec2 = (0.0, 0.0)) -> tuple[FloatArray, FloatArray]:
    """H (2, 15) of a fix of a method with this covariance (2, 2), and the covariance (2, 2) of what is new in it.

    `per_focal_ne_m`: what a lens that is longer than calibrated adds to it, per share of the focal length.
    """
    H = H_POSITION.copy()
    H[:, LASTING], H[:, FIX_LENS] = root_m(cov_m2), per_focal_ne_m
    return H, cov_m2 if method in BY_SHAPE else (1 - SHARE) * cov_m2


def mean_m2(claimed_m2: float, gone: float) -> float:
    """Variance of the mean of what lasts, over a way of so many `apart_m`, of fixes that claim so much each: all of it over one
    ground, and twice a share of 1 / gone in the end (the variance of a mean over a first-order Gauss-Markov process)."""
    gone = max(gone, LEAST_GONE)
    return SHARE * claimed_m2 * 2 * (gone - 1 + math.exp(-gone)) / gone**2


def unclaimed_m(off_m: float, claimed_m2: float, gone: float) -> float:
    """What is left of a distance without what the mean of such fixes is off by as they claim it, which every level made of them
    has."""
    return math.sqrt(max(0.0, off_m**2 - mean_m2(claimed_m2, gone)))


def known_m2(cov_m2: FloatArray, P: FloatArray, H: FloatArray) -> float:
    """By how much smaller, on an axis, a fix's innovation is for what is known of the lasting part. Other ground may begin at any
    moment, so no fix is gated for that."""
    ours = slice(0, LASTING.stop)
    seen = H[:, ours]
    (known_n, _), (_, known_e) = seen.dot(P[ours, ours]).dot(seen.T).tolist()
    (nn, _), (_, ee) = P[POSITION, POSITION].tolist()
    (claimed_n, _), (_, claimed_e) = cov_m2.tolist()
    return float(max(0.0, (nn + ee + SHARE * (claimed_n + claimed_e) - (known_n + known_e)) / 2))


def root_m(cov_m2: FloatArray) -> FloatArray:
    """(2, 2) what a 1-sigma of the lasting part is on the ground: the symmetric root of its covariance (zero where that is none,
    which the update refuses)."""
    (a, b), (_, c) = cov_m2.tolist()
    determinant = a * c - b * b
    if not (a > 0 and determinant > 0 and math.isfinite(determinant)):
        return np.zeros((2, 2))
    s = math.sqrt(determinant)
    return math.sqrt(SHARE / (a + c + 2 * s)) * np.array([[a + s, b], [b, c + s]])
