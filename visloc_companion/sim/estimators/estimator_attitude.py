"""The simulated autopilot's error of attitude: small, slow, and the same for its own control as for what it streams."""

from __future__ import annotations

import math
from random import Random

from visloc_companion.sim.vehicle import Body
from visloc_companion.sim.vehicles.vehicle_model import AttitudeErrors
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov

RATE_SIGMA_RADPS = math.radians(0.2)
PERIOD_S = 0.1


class AttitudeEstimate:
    """True attitude plus slowly varying errors.

    `compass_error_rad` is added to the heading: what a disturbed compass has talked the filter into so far. `tilt_ne_rad` is what
    the filter's own tilt is off by about north and east.
    """

    def __init__(self, rng: Random, model: AttitudeErrors) -> None:
        self._rng = rng
        self._errors = (
            GaussMarkov(rng, model.tilt_rad, model.tilt_s),
            GaussMarkov(rng, model.tilt_rad, model.tilt_s),
            GaussMarkov(rng, model.yaw_rad, model.yaw_s),
        )
        self._since_s = 0.0
        self.compass_error_rad = 0.0
        self.tilt_ne_rad = (0.0, 0.0)

    def step(self, dt_s: float) -> None:
        """Let the errors drift (ten times a second)."""
        self._since_s += dt_s
        if self._since_s >= PERIOD_S:
            self._since_s -= PERIOD_S
            for error in self._errors:
                error.step(PERIOD_S)

    @property
    def yaw_error_rad(self) -> float:
        """Estimated minus true yaw."""
        return self._errors[2].value + self.compass_error_rad

    def euler(self, body: Body) -> tuple[float, float, float]:
        """Estimated roll, pitch, yaw, radians."""
        roll, pitch, _ = (error.value for error in self._errors)
        north, east = self.tilt_ne_rad
        c, s = math.cos(body.yaw), math.sin(body.yaw)
        return body.roll + roll + c * north + s * east, body.pitch + pitch + c * east - s * north, body.yaw + self.yaw_error_rad

    def rates(self, body: Body) -> tuple[float, float, float]:
        """Gyroscope rates, rad/s."""
        x, y, z = (self._rng.gauss(0.0, RATE_SIGMA_RADPS) for _ in range(3))
        return body.rate_x + x, body.rate_y + y, body.rate_z + z
