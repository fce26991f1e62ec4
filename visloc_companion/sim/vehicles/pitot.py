"""The simulated plane's pitot tube: the velocity through the air, with a scale error of the flight and noise."""

from __future__ import annotations

import math
from random import Random

from visloc_companion.sim.vehicle import Body
from visloc_companion.sim.vehicles.vehicle_model import Tube
from visloc_companion.types import Vec3


class Pitot:
    """True airspeed as it is measured."""

    def __init__(self, rng: Random, model: Tube) -> None:
        self._rng, self._scale, self._noise = rng, model.scale + rng.gauss(0.0, model.scale_sigma), model.noise_mps

    def measured_mps(self, body: Body, wind_ned_mps: Vec3) -> float:
        """True airspeed, m/s."""
        air = math.hypot(body.v_north - wind_ned_mps[0], body.v_east - wind_ned_mps[1], body.v_down - wind_ned_mps[2])
        return max(0.0, self._scale * air + self._rng.gauss(0.0, self._noise))
