"""How far the truth may be: protection levels, from where the vehicle would be if fixes were wrong.

A level is the smallest radius r for which the probability that the error exceeds it is at most `integrity_risk`:

    sum over k of  p_k Q_k(r)  =  risk,     Q_k: the probability that the error is larger than r in the case k

k = 0 is the filter itself (p_0 = 1), the others are the solutions that leave fixes out (separation.py) and the places where the
vehicle is if fixes are wrong by the same offset (alike.py), with their probability; d_k is how far such a place is from what is
stated, s_k its 1-sigma, which includes what no solution can do without (the map).

In the plane the filter's own error is the ellipse that it is (`round_about`), that of each other place a circle of its larger
1-sigma about it (`beside`): a place reaches r in one direction only. Of a height's a bound is taken, Q((r - d_k) / s_k).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erfc, i0e, ndtri  # type: ignore[import-untyped]

from visloc_companion.core.filter.alike import Alike
from visloc_companion.core.filter.propagation import H_POSITION
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
LARGE = 0.4
"""What lies beyond a radius by more is taken to do so for certain."""
BETWEEN = np.linspace(0.0, 1.2, 9)
"""Where between what is too small and what is enough a radius is looked for at first, and one beyond."""
ABOUT = np.array([1.03, 1.0, 0.97, 0.85, 0.5, 0.0])
"""Where between the radius so found and what is enough it is looked for then: it may be a little off."""
NEAR, CLOSER = (1, 2), 12
"""Where none of these is the first that is enough, what is left is no parabola there (LARGE), and it is looked for once more, so
closely."""
LEAST_LEFT = 1e-30
NOTHING = 3e-4
"""What adds no more than this share of the risk by its bound is taken to add that."""
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


def on_line_m(apart_m: FloatArray, sigma_m: FloatArray, probability: FloatArray, risk: float) -> float:
    """The radius of the module's equation for errors on a line and d, s, p (K,). At most a thousandth of the largest radius tried
    too large."""
    sigmas = math.sqrt(2 * math.log(len(sigma_m) / risk)) + ROUNDING
    low, high = 0.0, float(np.maximum.reduce(apart_m + sigma_m * sigmas))
    for _ in range(2):
        radii = low + (high - low) * SHARES
        beyond = radii[:, None] - apart_m
        np.maximum(beyond, 0.0, out=beyond)
        beyond /= sigma_m
        enough = int((gaussian(beyond) @ probability <= risk).argmax())
        low, high = float(radii[max(0, enough - 1)]), float(radii[enough])
    return high


def beside(apart: FloatArray, a: FloatArray) -> FloatArray:
    """P(|error| > a sigma) of a Gaussian error in the plane of one sigma in all directions, about a place that is `apart` (K,)
    sigmas off, for a (N, K): from above, by next to nothing where it is small (Corazza & Ferrari, "New bounds for the Marcum
    Q-function", 2002), and 1 where it is more than LARGE: what is less only grows with the sigma of any direction."""
    past = a - apart
    tail = erfc(past / math.sqrt(2))
    tail *= math.sqrt(math.pi / 2) * apart
    tail += rayleigh(past)
    tail *= i0e(apart * a)
    np.copyto(tail, 1.0, where=(past <= 0) | (tail > LARGE))
    return np.asarray(tail)


def in_plane_m(own_m2: FloatArray, apart_m: FloatArray, sigma_m: FloatArray, probability: FloatArray, risk: float) -> float:
    """The radius of the module's equation in the plane, for the filter's own error (variances of `round_about`) and places of d,
    s, p (K,), up to 1 % too large where a place is less than a sigma off.

    What leaves any of them more than the risk in the half-plane beyond it is too small; what leaves each no more than its share
    by the bound of all directions is enough.
    """
    own_m, each = math.sqrt(own_m2[0]), risk / (1 + len(probability))
    likely = probability > each
    d, s, p = apart_m[likely], sigma_m[likely], probability[likely]
    high_m = np.maximum.reduce(d + s * np.sqrt(2 * np.log(p / each)), initial=own_m * math.sqrt(-2 * math.log(each)))
    too_small = (d - s * ndtri(np.minimum(risk / p, LARGE)))[p > risk]
    low_m = np.maximum.reduce(too_small, initial=-own_m * float(ndtri(risk / 2)))
    counts = probability * rayleigh(np.maximum((low_m - apart_m) / sigma_m, 0.0)) > NOTHING * risk
    s, p = sigma_m[counts], probability[counts]
    apart, owns_m = apart_m[counts] / s, np.sqrt(own_m2)
    allowed = (1 - NOTHING * (len(counts) - len(p))) * risk

    def left(radii_m: FloatArray) -> FloatArray:
        radii_m = radii_m[:, None]
        return np.asarray((rayleigh(radii_m / owns_m) @ CERTAIN + beside(apart, radii_m / s) @ p) / allowed)

    radii_m = low_m + (high_m - low_m) * BETWEEN
    shares = left(radii_m)
    enough = int((shares <= 1.0).argmax())
    if not 0 < enough < len(BETWEEN) - 1:
        return float(low_m if shares[0] <= 1.0 else radii_m[-1])
    about_m = radii_m[enough] - (radii_m[1] - radii_m[0]) * (1 - _crossing(shares[enough - 1 : enough + 2])) * ABOUT
    first = int((left(about_m) <= 1.0).argmax())
    if first in NEAR:
        return float(about_m[first])
    closer_m = np.linspace(about_m[first - 1] if first else radii_m[enough - 1], about_m[first], CLOSER)
    return float(closer_m[(left(closer_m) <= 1.0).argmax()])


def _crossing(left: FloatArray) -> float:
    """Where between the first two of three evenly spaced radii what is left, over what is allowed (3,), is 1: its logarithm, as
    that of a Gaussian tail, is taken to go on as the parabola through the three."""
    more, less, least = np.log(np.maximum(left, LEAST_LEFT)).tolist()
    curved = (more - 2 * less + least) / 2
    falls = more - less + curved
    return float(2 * more / (falls + math.sqrt(falls * falls - 4 * curved * more)))


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
    K, n = len(without) + len(alike), len(without)
    covs_m2, off_m = np.empty((4, K)), np.empty((K, 2))
    same_m, spread_m2 = alike.off_m(H_POSITION)
    covs_m2[:, :n], covs_m2[:, n:] = without.position_m2, P[:2, :2].reshape(4, 1) + spread_m2.reshape(-1, 4).T
    off_m[:n], off_m[n:] = without.x[:, :2] - x[:2], same_m
    (nn, ne), (_, ee) = P[:2, :2].tolist()
    map_m2 = settings.map_sigma_m**2
    own_m2 = round_about((nn + ee) / 2, math.hypot((nn - ee) / 2, ne)) + map_m2
    nns, nes, _, ees = covs_m2
    sigma_m = np.sqrt((nns + ees) / 2 + np.hypot((nns - ees) / 2, nes) + map_m2)
    probability = np.concatenate([without.probability, alike.probability])
    return in_plane_m(own_m2, np.hypot(off_m[:, 0], off_m[:, 1]), sigma_m, probability, settings.integrity_risk)


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
    return on_line_m(np.abs(offset_m), np.sqrt(var_m2 + shared_m2), probability, settings.integrity_risk)
