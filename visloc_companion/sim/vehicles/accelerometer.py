"""The simulated autopilot's accelerometers as they are streamed: with biases that its filter has learnt, and vibration."""

from __future__ import annotations

from random import Random

from visloc_companion.geo.se3 import quat_from_euler, quat_inverse, rotate
from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body
from visloc_companion.sim.vehicles.vehicle_model import Accelerometers
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import Vec3


class Accelerometer:
    """Specific force along the body's axes, with slow biases and white noise on each."""

    def __init__(self, rng: Random, model: Accelerometers) -> None:
        self._rng, self._t_s = rng, 0.0
        self._noise = model.noise_mps2
        self._biases = tuple(GaussMarkov(rng, model.bias_mps2, model.bias_s) for _ in range(3))

    def measured(self, body: Body, t_s: float) -> Vec3:
        """What is measured at a time, forward, right, down m/s²; times must not run back."""
        dt_s, self._t_s = t_s - self._t_s, t_s
        up = (body.a_north, body.a_east, body.a_down - GRAVITY_MPS2)
        true = rotate(quat_inverse(quat_from_euler(body.roll, body.pitch, body.yaw)), up)
        x, y, z = (
            f + bias.step(dt_s) + self._rng.gauss(0.0, noise)
            for f, bias, noise in zip(true, self._biases, self._noise, strict=True)
        )
        return x, y, z
