"""Bounds of the horizontal error that a single answer implies."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.types import FloatArray

RAYLEIGH_1E5 = math.sqrt(-2 * math.log(1e-5))
"""4.80: radius, in sigmas of a circular Gaussian, that an error exceeds once in 100,000."""
CHI2_95 = 5.991
"""95 % of the chi-squared distribution of two degrees of freedom."""


def horizontal_bound_m(covariance_m2: FloatArray) -> float:
    """Bound at a risk of 1e-5, metres, from the claimed horizontal covariance (2, 2): 4.80 times its largest sigma.

    Right if the place is right and its error Gaussian. It says nothing of wrong places; `probability_wrong` does.
    """
    return RAYLEIGH_1E5 * math.sqrt(float(np.linalg.eigvalsh(covariance_m2)[-1]))
