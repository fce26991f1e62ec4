"""How far the truth may be: largest sigma and a provisional horizontal protection level."""

from __future__ import annotations

import math

from visloc_companion.types import Cov2

PROTECTION_FACTOR = 4.80
"""sqrt(2 ln 1e5): a circular Gaussian is further out than this many sigma once in 1e5."""
AGE_DOUBLES_S = 30.0
WRONG_WEIGHT = 10.0


def largest_sigma_m(cov_ne_m2: Cov2) -> float:
    """Square root of the larger eigenvalue of a symmetric 2x2 covariance."""
    (nn, ne), (_, ee) = cov_ne_m2
    return math.sqrt((nn + ee) / 2 + math.hypot((nn - ee) / 2, ne))


def protection_level_m(cov_ne_m2: Cov2, age_of_fix_s: float, probability_wrong: float) -> float:
    """Provisional bound on the horizontal error, metres.

    4.80 largest sigma (the covariance includes the map's registration), doubled for each 30 s since the last fix, because
    the growth model of dead reckoning is not yet validated at that risk, and raised by ten times the mean probability that
    the recent fixes were wrong matches.
    """
    age = 1 + max(0.0, age_of_fix_s) / AGE_DOUBLES_S
    wrong = 1 + WRONG_WEIGHT * min(1.0, max(0.0, probability_wrong))
    return PROTECTION_FACTOR * largest_sigma_m(cov_ne_m2) * age * wrong
