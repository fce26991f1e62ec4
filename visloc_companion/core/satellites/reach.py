"""Whether a position that GNSS states can be that of the filter."""

from __future__ import annotations

from visloc_companion.types import Cov2, Vec2

GNSS_BIAS_SIGMA_M = 3.0
"""1-sigma of the constant difference between GNSS and map, for the question whether GNSS can be true at all."""


def out_of_reach(off_ne_m: Vec2, cov_ne_m2: Cov2, sigma_m: float, gate_sigma: float) -> bool:
    """Whether a position of a 1-sigma per axis that lies so far, north and east metres, from a state of this covariance is beyond
    the gate (Mahalanobis distance)."""
    (north, east), ((nn, ne), (_, ee)) = off_ne_m, cov_ne_m2
    own_m2 = sigma_m**2 + GNSS_BIAS_SIGMA_M**2
    nn, ee = nn + own_m2, ee + own_m2
    squared = (ee * north * north - 2 * ne * north * east + nn * east * east) / (nn * ee - ne * ne)
    return squared > gate_sigma**2
