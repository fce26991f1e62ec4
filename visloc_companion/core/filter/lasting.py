"""What neighbouring fixes get wrong in common: they look at the same ground, with the same error of the attitude.

A fix errs by a part that is new in each and one that lasts; the latter, in 1-sigmas of its own claim, is a pair of the filter's
states, first-order Gauss-Markov over the way that the vehicle has gone (a vehicle that hovers learns nothing from many fixes).
So odometry may carry the position while that error goes by, and a fix that claims little has little of it.

What the camera's mounting has of a claim (camera/tilt_memory.py) is another pair, in 1-sigmas of that: it does not go by, and it
turns with the vehicle, so that odometry tells its size where the vehicle turns. Where it has been learned, what fixes err by now
is a part of what they erred by before, and the rest of that was independent of it (the errors of a Kalman filter's estimates
before and after it has learned): not the same error in smaller 1-sigmas, of which two fixes would tell the size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from visloc_companion.core.filter.propagation import FIX_LENS, H_POSITION, LASTING, LASTS, MOUNTING, POSITION
from visloc_companion.types import FloatArray, Vec2

SHARE = 0.6
"""Of the variance that a fix claims, how much lasts (benchmarks/lasting.py)."""
APART = 0.6
"""It has gone by to 1/e after so many heights above the ground."""
LEAST_APART_M = 20.0
UNIT = np.eye(2)
"""It is never changed."""
LEAST_M2 = 1e-12
LEAST_GONE = 1e-3
"""Of less the mean's variance is rounding."""
LEAST_REST = 0.02
"""Of the variance that the mounting has of a fix, how much the rest is at least: a fix that claims less than its mounting's part
claims too little, and a mounting that seems to err by as much less tells nothing."""
NEW_M = 1.5
"""1-sigma, on each axis, of what is new in a fix whose mounting's part is known, at most: neighbouring fixes over 5 m a pixel err
anew by 0.5 m from 750 m and by 1.0 m from 277 m, where they claim 8 m, nearly all of it of the tilt."""
BY_SHAPE = frozenset({"structure", "terrain"})
"""Methods that share no more with images than the attitude: what lasts of their own error is another thing, and comes on top."""


class Mounting(NamedTuple):
    """What the camera's mounting has of a fix: its 1-sigma on each axis, on the ground, and the camera's heading."""

    sigma_m: float
    heading_rad: float

    @property
    def of_ground_m(self) -> FloatArray:
        """(2, 2) what a 1-sigma ahead and one to the right are north and east."""
        ahead, right = self.sigma_m * math.cos(self.heading_rad), self.sigma_m * math.sin(self.heading_rad)
        return np.array([[ahead, -right], [right, ahead]])

    def rest_m2(self, cov_m2: FloatArray) -> FloatArray:
        """(2, 2) what is left of a fix's covariance (2, 2)."""
        (a, b), (_, c) = cov_m2.tolist()
        mounting_m2 = self.sigma_m**2
        left_m2 = (a + c) / 2 - math.hypot((a - c) / 2, b) - mounting_m2
        rest_m2: FloatArray = cov_m2 - (mounting_m2 + min(0.0, left_m2 - LEAST_REST * mounting_m2)) * UNIT
        return rest_m2


def learned(before_rad: float, now_rad: float) -> float:
    """What the mounting's error is expected to be now of what it was, both in 1-sigmas of what was known and is known of it; 0
    where nothing was."""
    return min(before_rad, now_rad) / max(before_rad, now_rad)


def apart_m(height_m: float) -> float:
    """The way after which fixes from a height above the ground look at other ground."""
    return max(LEAST_APART_M, APART * height_m)


def seen(
    cov_m2: FloatArray, method: str, per_focal_ne_m: Vec2 = (0.0, 0.0), mounting: Mounting | None = None
) -> tuple[FloatArray, FloatArray]:
    """H (2, 17) of a fix of a method with this covariance (2, 2), and the covariance (2, 2) of what is new in it.

    `per_focal_ne_m`: what a lens that is longer than calibrated adds to it, per share of the focal length. `mounting`: what that
    has of it, where it is known.
    """
    H = H_POSITION.copy()
    H[:, FIX_LENS] = per_focal_ne_m
    if mounting is None:
        H[:, LASTING] = root_m(cov_m2)
        return H, cov_m2 if method in BY_SHAPE else (1 - SHARE) * cov_m2
    H[:, MOUNTING] = mounting.of_ground_m
    rest_m2 = mounting.rest_m2(cov_m2)
    new = min(1 - SHARE, NEW_M**2 / max(float(np.trace(rest_m2)) / 2, LEAST_M2))
    H[:, LASTING] = root_m((1 - new) / SHARE * rest_m2)
    return H, new * rest_m2


def mean_m2(claimed_m2: float, gone: float) -> float:
    """Variance of the mean of what lasts, over a way of so many `apart_m`, of fixes that claim so much each: all of it over one
    ground, and twice a share of 1 / gone in the end (the variance of a mean over a first-order Gauss-Markov process)."""
    gone = max(gone, LEAST_GONE)
    return SHARE * claimed_m2 * 2 * (gone - 1 + math.exp(-gone)) / gone**2


def unclaimed_m(off_m: float, claimed_m2: float, gone: float) -> float:
    """What is left of a distance without what the mean of such fixes is off by as they claim it, which every level made of them
    has."""
    return math.sqrt(max(0.0, off_m**2 - mean_m2(claimed_m2, gone)))


def known_m2(P: FloatArray, H: FloatArray) -> float:
    """By how much smaller, on an axis, a fix's innovation is for what is known of the lasting part. Other ground may begin at any
    moment, so no fix is gated for that."""
    ours = slice(0, MOUNTING.stop)
    seen = H[:, ours]
    (known_n, _), (_, known_e) = seen.dot(P[ours, ours]).dot(seen.T).tolist()
    (nn, _), (_, ee) = P[POSITION, POSITION].tolist()
    lasts = H[:, LASTS]
    return float(max(0.0, (nn + ee + float(np.vdot(lasts, lasts)) - (known_n + known_e)) / 2))


def root_m(cov_m2: FloatArray) -> FloatArray:
    """(2, 2) what a 1-sigma of the lasting part is on the ground: the symmetric root of its covariance (zero where that is none,
    which the update refuses)."""
    (a, b), (_, c) = cov_m2.tolist()
    determinant = a * c - b * b
    if not (a > 0 and determinant > 0 and math.isfinite(determinant)):
        return np.zeros((2, 2))
    s = math.sqrt(determinant)
    return math.sqrt(SHARE / (a + c + 2 * s)) * np.array([[a + s, b], [b, c + s]])
