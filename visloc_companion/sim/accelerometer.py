"""The simulated autopilot's accelerometers as they are streamed: with biases that its filter has learnt, and vibration."""

from __future__ import annotations

from random import Random

from visloc_companion.geo.se3 import quat_from_euler, quat_inverse, rotate
from visloc_companion.sim.vehicle import GRAVITY_MPS2, Body
from visloc_companion.sim.vehicle_noise import GaussMarkov
from visloc_companion.types import Vec3

BIAS_SIGMA_MPS2, BIAS_TAU_S = 0.15, 100.0
VIBRATION_SIGMA_MPS2 = 0.5
"""Of a single sample: what the differences between samples of a real copter show (0.5 to 0.6 m/s² at 50 Hz)."""


class Accelerometer:
    """Specific force along the body's axes: slow biases of 0.15 m/s² in 100 s on each axis (1-sigma), white noise."""

    def __init__(self, rng: Random) -> None:
        self._rng, self._t_s = rng, 0.0
        self._biases = tuple(GaussMarkov(rng, BIAS_SIGMA_MPS2, BIAS_TAU_S) for _ in range(3))

    def measured(self, body: Body, t_s: float) -> Vec3:
        """What is measured at a time, forward, right, down m/s²; times must not run back."""
        dt_s, self._t_s = t_s - self._t_s, t_s
        up = (body.a_north, body.a_east, body.a_down - GRAVITY_MPS2)
        true = rotate(quat_inverse(quat_from_euler(body.roll, body.pitch, body.yaw)), up)
        x, y, z = (
            f + bias.step(dt_s) + self._rng.gauss(0.0, VIBRATION_SIGMA_MPS2) for f, bias in zip(true, self._biases, strict=True)
        )
        return x, y, z
