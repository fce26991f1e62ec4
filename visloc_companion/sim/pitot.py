"""The simulated plane's pitot tube: the velocity through the air, with a scale error of the flight and noise."""

from __future__ import annotations

import math
from random import Random

from visloc_companion.sim.vehicle import Body
from visloc_companion.types import Vec3

SCALE_SIGMA, NOISE_SIGMA_MPS = 0.03, 0.3


class Pitot:
    """True airspeed as it is measured: 3 % of scale (1-sigma, constant), 0.3 m/s of noise."""

    def __init__(self, rng: Random) -> None:
        self._rng, self._scale = rng, 1 + rng.gauss(0.0, SCALE_SIGMA)

    def measured_mps(self, body: Body, wind_ned_mps: Vec3) -> float:
        """True airspeed, m/s."""
        air = math.hypot(body.v_north - wind_ned_mps[0], body.v_east - wind_ned_mps[1], body.v_down - wind_ned_mps[2])
        return max(0.0, self._scale * air + self._rng.gauss(0.0, NOISE_SIGMA_MPS))
