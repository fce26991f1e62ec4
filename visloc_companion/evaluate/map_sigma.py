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

    The defaults are what two dates of a place differ by on training data: 0.5 to 0.8 m horizontally at 1 m a pixel (after a
    shift that is common to the whole image is taken out), 1.7 m at 5 m a pixel; in height what made the claims of training
    pairs without surface model, and of made ground five years on with the old one, agree with their errors
    (`python -m benchmarks.registration`, docs/benchmarks.md).
    """

    horizontal_m: float = 0.7
    height_m: float = 0.5


def with_map_sigma(fix: Fix, sigma: MapSigma) -> Fix:
    """The fix with the map's own error in what it claims."""
    (nn, ne), (en, ee) = fix.cov_ne_m2
    added = sigma.horizontal_m**2
    return replace(fix, cov_ne_m2=((nn + added, ne), (en, ee + added)), sigma_h_m=math.hypot(fix.sigma_h_m, sigma.height_m))
