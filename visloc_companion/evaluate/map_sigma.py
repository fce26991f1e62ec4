"""What a map is off by itself, as far as nobody has stated it for a folder of cases.

A localiser's covariance is that of the camera against the map. In flight the filter adds the map's own error once
(`navigator.map_sigma_m`, `navigator.map_sigma_h_m`); a single case that is judged against the earth has no filter behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from visloc_companion.types import Fix


@dataclass(frozen=True, slots=True)
class MapSigma:
    """1-sigma of a map's registration on each horizontal axis, and of its heights, metres.

    The defaults were set on training cases. Two dates of a place at 1 m a pixel are 0.5 m apart on each axis, less the shift that
    the whole image has, and 1.7 m at 5 m a pixel (`python -m benchmarks.registration`); with 0.7 m 92 % of the errors of training
    pairs lie in their 95 % ellipse. In height 0.5 m made the claims of these pairs, which have no surface model,
    and of made ground over its model of five years before agree with their errors.
    """

    horizontal_m: float = 0.7
    height_m: float = 0.5


def with_map_sigma(fix: Fix, sigma: MapSigma) -> Fix:
    """The fix with the map's own error in what it claims."""
    (nn, ne), (en, ee) = fix.cov_ne_m2
    added = sigma.horizontal_m**2
    return replace(fix, cov_ne_m2=((nn + added, ne), (en, ee + added)), sigma_h_m=math.hypot(fix.sigma_h_m, sigma.height_m))
