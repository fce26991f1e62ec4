"""How far the truth may be: the horizontal protection level, from where the vehicle would be if fixes were wrong."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core.separation import Solutions
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Cov2, FloatArray

AGE_DOUBLES_S = 30.0
"""The growth of dead reckoning is a model: what it claims without a fix is doubled after so long."""
GRID = 33
ROUNDING = 1e-6
"""So that the largest radius tried is certainly enough."""


def largest_sigma_m(cov_ne_m2: Cov2) -> float:
    """Square root of the larger eigenvalue of a symmetric 2x2 covariance."""
    (nn, ne), (_, ee) = cov_ne_m2
    return math.sqrt((nn + ee) / 2 + math.hypot((nn - ee) / 2, ne))


def aged(level_m: float, age_of_fix_s: float) -> float:
    """A protection level so long after the last fix."""
    return level_m * (1 + max(0.0, age_of_fix_s) / AGE_DOUBLES_S)


def protection_level_m(x: FloatArray, P: FloatArray, without: Solutions, settings: NavigatorSettings) -> float:
    """The smallest radius r for which the probability that the horizontal error exceeds it is at most `integrity_risk`:

        Q(r / s0) + sum over k of  p_k Q((r - d_k) / s_k)  =  risk,     Q(a) = exp(-a^2 / 2) for a > 0, else 1

    s0: largest sigma of the filter's position, k: the solutions that leave fixes out (separation.py), p_k their probability,
    d_k their distance from the filter's position, s_k their own largest sigma. Q bounds a Gaussian error of no larger sigma in
    any direction (Rayleigh). Every sigma includes the map's registration, which no solution can do without.
    x (4,), P (4, 4): the filter's. The answer is at most a thousandth too large.
    """
    P_ne = np.concatenate([P[None, :2, :2], without.P[:, :2, :2]])
    nn, ee, ne = P_ne[:, 0, 0], P_ne[:, 1, 1], P_ne[:, 0, 1]
    sigma = np.sqrt((nn + ee) / 2 + np.hypot((nn - ee) / 2, ne) + settings.map_sigma_m**2)
    apart = np.concatenate([[0.0], np.hypot(*(without.x[:, :2] - x[:2]).T)])
    probability = np.concatenate([[1.0], without.probability])
    sigmas = math.sqrt(2 * math.log(len(sigma) / settings.integrity_risk)) + ROUNDING
    low, high = 0.0, float(np.max(apart + sigma * sigmas))
    for _ in range(2):
        radii = np.linspace(low, high, GRID)
        beyond = np.maximum(radii[:, None] - apart, 0.0) / sigma
        enough = int(np.argmax(np.exp(-0.5 * beyond * beyond) @ probability <= settings.integrity_risk))
        low, high = float(radii[max(0, enough - 1)]), float(radii[enough])
    return high
