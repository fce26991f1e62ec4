"""A simulated rangefinder along the vehicle's down axis: the distance to the surface, with noise, within its reach."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from visloc_companion.geo.se3 import rotate
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import GeoPoint, Quat

Surface = Callable[[GeoPoint], float]
"""Height above sea level of what a beam meets at a place; NaN where nothing comes back."""
ROUNDS = 6
"""Of the fixed-point iteration for the distance, which converges where slope times tangent of the tilt is below one."""


@dataclass(frozen=True, slots=True)
class Rangefinder:
    """A laser altimeter of the long-range kind: 1-sigma of a distance `sigma_m` + `sigma_share` of it, reach `max_m`."""

    surface: Surface
    max_m: float = 400.0
    min_m: float = 0.5
    sigma_m: float = 0.1
    sigma_share: float = 0.001

    def measured_m(self, place: GeoPoint, q_ned_frd: Quat, rng: Random) -> float | None:
        """The distance from a place and attitude, None where nothing comes back or the surface is out of reach."""
        down = rotate(q_ned_frd, (0.0, 0.0, 1.0))
        noise = rng.gauss(0.0, 1.0)
        distance = 0.0
        for _ in range(ROUNDS):
            met = geo_from_ned((distance * down[0], distance * down[1], 0.0), place)
            below = place.h_amsl_m - self.surface(met)
            if not math.isfinite(below) or down[2] <= 0:
                return None
            distance = min(max(below / down[2], 0.0), self.max_m + 1.0)
        if not self.min_m <= distance <= self.max_m:
            return None
        return distance + noise * (self.sigma_m + self.sigma_share * distance)
