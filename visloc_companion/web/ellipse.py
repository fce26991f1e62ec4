"""The ellipse that holds the true position with a probability of 95 %, were the error Gaussian with the claimed covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import Cov2

CHI2_95 = -2.0 * math.log(0.05)
"""95 % quantile of chi squared with two degrees of freedom (5.991)."""


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Semi-axes in metres, and where the major one points, degrees clockwise from true north, 0 to 180."""

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float


def ellipse_95(cov_ne_m2: Cov2) -> Ellipse:
    """Of a positive semi-definite covariance (m²), axes north and east."""
    (nn, ne), (_, ee) = cov_ne_m2
    middle, reach = (nn + ee) / 2, math.hypot((nn - ee) / 2, ne)
    azimuth_rad = 0.5 * math.atan2(2 * ne, nn - ee)
    major, minor = (math.sqrt(CHI2_95 * max(0.0, variance)) for variance in (middle + reach, middle - reach))
    return Ellipse(major, minor, math.degrees(azimuth_rad) % 180.0)
