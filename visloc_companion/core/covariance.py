"""What a covariance of a place says: its longest axis, and the same with no axis below a floor."""

from __future__ import annotations

import math

from visloc_companion.types import Cov2


def largest_sigma_m(cov_ne_m2: Cov2) -> float:
    """Square root of the larger eigenvalue of a symmetric 2x2 covariance; 0 where that is negative, NaN where one of it is."""
    (nn, ne), (_, ee) = cov_ne_m2
    larger = (nn + ee) / 2 + math.hypot((nn - ee) / 2, ne)
    return 0.0 if larger < 0 else math.sqrt(larger)


def floored(cov_ne_m2: Cov2, min_sigma_m: float) -> Cov2:
    """The covariance with no principal sigma below a floor."""
    (nn, ne), (_, ee) = cov_ne_m2
    middle, reach, least = (nn + ee) / 2, math.hypot((nn - ee) / 2, ne), min_sigma_m**2
    larger, smaller = middle + reach, middle - reach
    if smaller >= least:
        return cov_ne_m2
    if larger <= least:
        return (least, 0.0), (0.0, least)
    share = (least - smaller) / (larger - smaller)  # of what lies along the smaller axis, (larger I - cov) / (larger - smaller)
    ne -= share * ne
    return (nn + share * (larger - nn), ne), (ne, ee + share * (larger - ee))
