"""What a map is off by itself, as far as nobody has stated it for a folder of cases.

A localiser's covariance is that of the camera against the map. In flight the filter adds the map's own error once
(`navigator.map_sigma_m`, `navigator.map_sigma_h_m`); a single case that is judged against the earth has no filter behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from visloc_companion.errors import ConfigError
from visloc_companion.evaluate.number_list import number_texts
from visloc_companion.types import Fix

LARGEST_M = 1000.0
"""As `--map-sigma-h-m` takes it."""


@dataclass(frozen=True, slots=True)
class MapSigma:
    """1-sigma of a map's registration to the north and to the east, and of its heights, metres.

    The defaults were set on training cases. Two dates of a place at 1 m a pixel are 0.5 m apart on each axis, less the shift that
    the whole image has, and 1.7 m at 5 m a pixel (`python -m benchmarks.registration`); with 0.7 m 92 % of the errors of training
    pairs lie in their 95 % ellipse. In height 0.5 m made the claims of these pairs, which have no surface model,
    and of made ground over its model of five years before agree with their errors.
    """

    north_m: float = 0.7
    east_m: float = 0.7
    height_m: float = 0.5


def with_map_sigma(fix: Fix, sigma: MapSigma) -> Fix:
    """The fix with the map's own error in what it claims."""
    (nn, ne), (en, ee) = fix.cov_ne_m2
    cov_ne_m2 = (nn + sigma.north_m**2, ne), (en, ee + sigma.east_m**2)
    return replace(fix, cov_ne_m2=cov_ne_m2, sigma_h_m=math.hypot(fix.sigma_h_m, sigma.height_m))


def stated(horizontal: str | None, height_m: float | None) -> MapSigma:
    """What is stated of a map as `--map-sigma-m` (one number for both axes, or north and east: "0.4,0.8" or "0.4 0.8") and
    `--map-sigma-h-m`; the defaults for None. Raises ConfigError naming the option."""
    sigma = MapSigma()
    if horizontal is not None:
        north_m, east_m = _axes_m(horizontal)
        sigma = replace(sigma, north_m=north_m, east_m=east_m)
    return sigma if height_m is None else replace(sigma, height_m=height_m)


def _axes_m(text: str) -> tuple[float, float]:
    try:
        sigmas_m = [float(part) for part in number_texts(text)]
    except ValueError:
        sigmas_m = []
    if len(sigmas_m) not in (1, 2) or not all(0 <= sigma_m <= LARGEST_M for sigma_m in sigmas_m):
        remedy = 'give metres: 0.7 for both axes, or "0.4,0.8" for north and east'
        raise ConfigError(f"{text!r} is no 1-sigma of a map", where="--map-sigma-m", remedy=remedy)
    return sigmas_m[0], sigmas_m[-1]
