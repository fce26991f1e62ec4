"""How far the truth may be: protection levels, from where the vehicle would be if fixes were wrong.

A level is the smallest radius r for which the probability that the error exceeds it is at most `integrity_risk`:

    sum over k of  p_k Q((r - d_k) / s_k)  =  risk,     Q(a) = 1 for a <= 0

k = 0 is the filter itself (p_0 = 1), the others are the solutions that leave fixes out (separation.py) and the places where the
vehicle is if fixes are wrong by the same offset (alike.py), with their probability; d_k is how far such a place is from what is
stated, s_k its 1-sigma, which includes what no solution can do without (the map).

That is a bound: a place that is d_k away reaches r in one direction only, and an ellipse along its longer axis only. Of the
filter's own error all is known, so of that the probability itself is taken (`round_about`). How probable the others are is
assumed in part; what their bound leaves over is needed (docs/decisions/0097-the-filters-own-error-is-an-ellipse.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from visloc_companion.core.filter.alike import Alike
from visloc_companion.core.filter.lasting import SHARE
from visloc_companion.core.filter.separation import Solutions
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

AGE_DOUBLES_S = 30.0
"""The growth of dead reckoning is a model: what it claims without a fix is doubled after so long."""
HEIGHT_SHARE = 0.005
"""1-sigma, as a share of the height flown, of what heights from images have in common: focal length, surface model."""
GRID = 33
SHARES = np.linspace(0.0, 1.0, GRID)
DIRECTIONS = 11
CERTAIN = np.array([0.5, *[1.0] * (DIRECTIONS - 2), 0.5]) / (DIRECTIONS - 1)
"""Probability of the filter itself, in so many directions of its error: the first and the last are of the axes."""
TURNED = np.cos(np.linspace(0.0, math.pi, DIRECTIONS))
LEAST_SHARE = 1e-9
"""Of the larger variance: a line's other one is none, or a rounding below."""
ROUNDING = 1e-6
"""So that the largest radius tried is certainly enough."""


def aged(level_m: float, age_of_fix_s: float) -> float:
    """A protection level so long after the last fix."""
    return level_m * (1 + max(0.0, age_of_fix_s) / AGE_DOUBLES_S)


def rayleigh(a: FloatArray) -> FloatArray:
    """Bounds P(|error| > a sigma) of a Gaussian error in the plane of no larger sigma in any direction."""
    squared = -0.5 * a
    squared *= a
    return np.exp(squared, out=squared)


def gaussian(a: FloatArray) -> FloatArray:
    """Bounds P(|error| > a sigma) of a Gaussian error on a line, erfc(a / sqrt 2), from above, by less than 3 % where a > 3
    (Abramowitz & Stegun, 7.1.13)."""
    x = a / math.sqrt(2)
    return np.asarray(2 / math.sqrt(math.pi) * np.exp(-x * x) / (x + np.sqrt(x * x + 4 / math.pi)))


def bound_m(
    apart_m: FloatArray,
    sigma_m: FloatArray,
    probability: FloatArray,
    risk: float,
    tail: Callable[[FloatArray], FloatArray],
) -> float:
    """The radius of the module's equation for d, s, p (K,); `tail` is at most exp(-a^2 / 2). At most a thousandth of the largest
    radius tried too large."""
    sigmas = math.sqrt(2 * math.log(len(sigma_m) / risk)) + ROUNDING
    low, high = 0.0, float(np.maximum.reduce(apart_m + sigma_m * sigmas))
    for _ in range(2):
        radii = low + (high - low) * SHARES
        beyond = radii[:, None] - apart_m
        np.maximum(beyond, 0.0, out=beyond)
        beyond /= sigma_m
        enough = int((tail(beyond) @ probability <= risk).argmax())
        low, high = float(radii[max(0, enough - 1)]), float(radii[enough])
    return high


def round_about(middle_m2: float, reach_m2: float) -> FloatArray:
    """Variances (DIRECTIONS,) of circles, CERTAIN of them, that together reach as far as one ellipse, whose principal variances
    are the middle plus and less the reach.

    An error A n, n of two normal coordinates, has in each direction phi of n a length of Rayleigh's, of variance middle + reach
    cos 2 phi. The mean over evenly spaced directions of what is smooth and periodic converges faster than any power of their
    number (Trefethen & Weideman, "The exponentially convergent trapezoidal rule", 2014): here it is right to a millionth.
    """
    return np.maximum(middle_m2 + reach_m2 * TURNED, LEAST_SHARE * (middle_m2 + reach_m2))


def protection_level_m(x: FloatArray, P: FloatArray, without: Solutions, alike: Alike, settings: NavigatorSettings) -> float:
    """Bound of the horizontal error of the filter's position; x (n,), P (n, n) begin with north and east."""
    n, K = 1 + len(without), 1 + len(without) + len(alike)
    own_m2, covs_m2, off_m = P[:2, :2].reshape(4, 1), np.empty((4, K)), np.zeros((K + DIRECTIONS - 1, 2))
    covs_m2[:, :1], covs_m2[:, 1:n] = own_m2, without.position_m2
    covs_m2[:, n:] = (1 - SHARE) * own_m2 + alike.cov_m2.reshape(-1, 4).T
    off_m[DIRECTIONS : DIRECTIONS + n - 1], off_m[DIRECTIONS + n - 1 :] = without.x[:, :2] - x[:2], alike.off_m
    probability = np.concatenate([CERTAIN, without.probability, alike.probability])
    nn, ne, _, ee = covs_m2
    middle_m2, reach_m2 = (nn + ee) / 2, np.hypot((nn - ee) / 2, ne)
    own = round_about(float(middle_m2[0]), float(reach_m2[0]))
    largest_m2 = np.concatenate([own, (middle_m2 + reach_m2)[1:]])
    largest_m2 += settings.map_sigma_m**2
    apart_m, sigma_m = np.hypot(off_m[:, 0], off_m[:, 1]), np.sqrt(largest_m2)
    return bound_m(apart_m, sigma_m, probability, settings.integrity_risk, rayleigh)


def vertical_protection_level_m(
    offset_m: FloatArray,
    var_m2: FloatArray,
    probability: FloatArray,
    height_above_home_m: float,
    settings: NavigatorSettings,
) -> float:
    """Bound of the error of the autopilot's own height, which is what is stated and sent: `offset_m` (K,) is by how much each
    solution (the first is the filter) would raise it, so an error that is known counts as much as one that is not."""
    shared_m2 = settings.map_sigma_h_m**2 + (HEIGHT_SHARE * height_above_home_m) ** 2
    return bound_m(np.abs(offset_m), np.sqrt(var_m2 + shared_m2), probability, settings.integrity_risk, gaussian)
