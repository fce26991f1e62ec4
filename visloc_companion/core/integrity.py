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
from collections.abc import Callable

import numpy as np
from scipy.special import erfc, i0e  # type: ignore[import-untyped]

from visloc_companion.core.filter.alike import Alike
from visloc_companion.core.filter.by_gnss import released
from visloc_companion.core.filter.propagation import H_POSITION
from visloc_companion.core.filter.separation import HELD, Solutions
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

AGE_DOUBLES_S = 30.0
"""The growth of dead reckoning is a model: what it claims without a fix is doubled after so long."""
HEIGHT_SHARE = 0.005
"""1-sigma, as a share of the height flown, of what heights from images have in common: focal length, surface model."""
DIRECTIONS = 11
CERTAIN = np.array([0.5, *[1.0] * (DIRECTIONS - 2), 0.5]) / (DIRECTIONS - 1)
"""Probability of the filter itself, in so many directions of its error: the first and the last are of the axes."""
NOT_APART_M = np.zeros(DIRECTIONS)
TURNED = np.cos(np.linspace(0.0, math.pi, DIRECTIONS))
LEAST_SHARE = 1e-9
"""Of the larger variance: a line's other one is none, or a rounding below."""
LARGE = 0.4
"""What lies beyond a radius by more is taken to do so for certain."""
BENDS = 0.05
"""Where a place leaves more than that beyond a radius, it soon leaves no more within: how it falls there tells nothing."""
GUESS_SHARE = 0.3
"""Of the risk, what the farthest place leaves beyond the radius that is tried first."""
TIGHT, BEYOND = 1e-3, 3e-4
"""A radius is near enough the least one where it is too large by less than this share; one that is looked for is taken so much
larger, so that the next look finds it enough."""
NEWTON, WIDER = 6, 1.2
"""So often a radius is looked for by what is left and how it falls, then by halves."""
LEAST_LEFT = 1e-300
FLAT = 1e-6
"""Where what is left falls by less than this share of the risk, how it falls says nothing of where it would be more."""


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
    """The radius of the module's equation for errors on a line and d, s, p (K,), where 1 is among p (`_least_m`)."""
    falling = math.sqrt(2 / math.pi) * probability / sigma_m

    def beyond(radius_m: float) -> tuple[float, float]:
        a = (radius_m - apart_m) / sigma_m
        tail, falls = gaussian(np.maximum(a, 0.0, out=a)), rayleigh(a)
        np.copyto(falls, 0.0, where=tail > BENDS)
        return float(tail.dot(probability)), float(falls.dot(falling))

    return _least_m(_farthest_m(apart_m, sigma_m, probability, risk), beyond, risk)


def _farthest_m(apart_m: FloatArray, sigma_m: FloatArray, probability: FloatArray, risk: float) -> float:
    """The radius beyond which the place (K,) that reaches farthest leaves about GUESS_SHARE of the risk."""
    sigmas = np.sqrt(2 * np.log(np.maximum(probability / (GUESS_SHARE * risk), 1.0)))
    return float(np.maximum.reduce(apart_m + sigma_m * sigmas))


def _least_m(radius_m: float, beyond: Callable[[float], tuple[float, float]], risk: float) -> float:
    """A radius beyond which no more than the risk is left, by about TIGHT larger than the least one at most.

    `beyond`: what is left beyond a radius, which falls with it from more than the risk, and by how much a metre more takes off.
    Looked for from a radius on by Newton's method on the logarithm of what is left: as that of a Gaussian tail it bends down, so
    the next radius is rather too large. Only a radius that was tried, and enough, is given; none is where the first is no number.
    """
    if not math.isfinite(radius_m):
        return math.inf
    too_small_m, enough_m, n = 0.0, math.inf, 0
    while True:
        left, slope_per_m = beyond(radius_m)
        further_m = math.log(max(left, LEAST_LEFT) / risk) * left / slope_per_m if slope_per_m > 0 else -math.inf
        if left > risk:
            too_small_m = radius_m
        else:
            enough_m, near_m = radius_m, TIGHT * radius_m
            falls = slope_per_m * near_m > FLAT * risk
            if enough_m - too_small_m <= near_m or (falls and -further_m <= near_m):
                return enough_m
        radius_m, n = (radius_m + further_m) * (1 + BEYOND), n + 1
        if n > NEWTON or not too_small_m < radius_m < enough_m:
            radius_m = (too_small_m + enough_m) / 2 if enough_m < math.inf else WIDER * too_small_m


def beside(apart: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """P(|error| > a sigma) of a Gaussian error in the plane of one sigma in all directions, about a place that is `apart` (K,)
    sigmas off, for a (..., K): from above, by next to nothing where it is small (Corazza & Ferrari, "New bounds for the Marcum
    Q-function", 2002), and 1 where it is more than LARGE, so wherever a is not beyond the place: what is less only grows with the
    sigma of any direction. And by how much the probability, not its bound, falls with a: the density of |error|, or 0 where it is
    more than BENDS."""
    past = a - apart
    falls = rayleigh(past)
    past *= math.sqrt(0.5)
    tail = erfc(past)
    tail *= apart
    tail *= math.sqrt(math.pi / 2)
    tail += falls
    scaled = i0e(apart * a)
    tail *= scaled
    falls *= scaled
    falls *= a
    np.copyto(falls, 0.0, where=tail > BENDS)
    np.copyto(tail, 1.0, where=tail > LARGE)
    return np.asarray(tail), falls


def in_plane_m(apart_m: FloatArray, sigma_m: FloatArray, probability: FloatArray, risk: float) -> float:
    """The radius of the module's equation in the plane for places of d, s, p (K,), of which some have p of 1 together, by the
    bound of each (`beside`, `_least_m`)."""
    per_m = 1 / sigma_m
    apart, falling = apart_m * per_m, probability * per_m

    def beyond(radius_m: float) -> tuple[float, float]:
        tail, falls = beside(apart, radius_m * per_m)
        return float(tail.dot(probability)), float(falls.dot(falling))

    return _least_m(_farthest_m(apart_m, sigma_m, probability, risk), beyond, risk)


def round_about(middle_m2: float, reach_m2: float) -> FloatArray:
    """Variances (DIRECTIONS,) of circles, CERTAIN of them, that together reach as far as one ellipse, whose principal variances
    are the middle plus and less the reach.

    An error A n, n of two normal coordinates, has in each direction phi of n a length of Rayleigh's, of variance middle + reach
    cos 2 phi. The mean over evenly spaced directions of what is smooth and periodic converges faster than any power of their
    number (Trefethen & Weideman, "The exponentially convergent trapezoidal rule", 2014): here it is right to a millionth.
    """
    return np.maximum(middle_m2 + reach_m2 * TURNED, LEAST_SHARE * (middle_m2 + reach_m2))


def protection_level_m(
    x: FloatArray, P: FloatArray, without: Solutions, alike: Alike, settings: NavigatorSettings, gnss_false: float = 1.0
) -> float:
    """Bound of the horizontal error of the filter's position; x (n,), P (n, n) begin with north and east.

    Where a GNSS tells where the filter is, which is false with the probability `gnss_false`, the filter itself counts with that,
    and what GNSS holds with the rest (by_gnss.py).
    """
    without = released(without) if gnss_false >= 1 else without
    (nn, ne), (_, ee) = P[:2, :2].tolist()
    out_m, (out_nns, out_nes, _, out_ees) = without.x[:, :2] - x[:2], without.position_m2
    (alike_north_m, alike_east_m), (more_nns, more_ees, more_nes) = alike.off_m(H_POSITION)
    nns, ees = np.concatenate((out_nns, more_nns + nn)), np.concatenate((out_ees, more_ees + ee))
    nes = np.concatenate((out_nes, more_nes + ne))
    own_m2 = round_about((nn + ee) / 2, math.hypot((nn - ee) / 2, ne))
    variance_m2 = np.concatenate((own_m2, (nns + ees) / 2 + np.hypot((nns - ees) / 2, nes)))
    variance_m2 += settings.map_sigma_m**2
    apart_m = np.concatenate((NOT_APART_M, np.hypot(out_m[:, 0], out_m[:, 1]), np.hypot(alike_north_m, alike_east_m)))
    probability = np.concatenate((CERTAIN, without.probability, alike.probability))
    if HELD in without.leaves:
        probability[:DIRECTIONS] *= gnss_false
        probability[DIRECTIONS + without.leaves.index(HELD)] = 1 - gnss_false
    return in_plane_m(apart_m, np.sqrt(variance_m2), probability, settings.integrity_risk)


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
