"""Seeded coloured noise for the simulated vehicle and its sensors, in plain floats."""

from __future__ import annotations

import math
from random import Random


class GaussMarkov:
    """First-order Gauss-Markov process: stationary 1-sigma `sigma`, correlation time `tau_s`."""

    __slots__ = ("_decay", "_drive", "_dt_s", "_rng", "sigma", "tau_s", "value")

    def __init__(self, rng: Random, sigma: float, tau_s: float) -> None:
        self._rng, self.sigma, self.tau_s = rng, sigma, tau_s
        self._dt_s = self._decay = self._drive = 0.0
        self.value = rng.gauss(0.0, sigma)

    def step(self, dt_s: float) -> float:
        """Advance and return the value."""
        if dt_s != self._dt_s:
            self._dt_s, self._decay = dt_s, math.exp(-dt_s / self.tau_s)
            self._drive = self.sigma * math.sqrt(1 - self._decay * self._decay)
        self.value = self.value * self._decay + self._rng.gauss(0.0, self._drive)
        return self.value


class Wind:
    """Mean wind with gusts: longitudinal Dryden spectra (MIL-F-8785C, first order) seen at a given airspeed.

    The gusts' 1-sigma is `gust_share` of the mean wind's speed (half of it vertically), their length 200 m.
    """

    LENGTH_M = 200.0

    def __init__(self, rng: Random, mean_ned_mps: tuple[float, float, float], airspeed_mps: float, gust_share: float) -> None:
        self._mean = mean_ned_mps
        sigma, tau = gust_share * math.hypot(*mean_ned_mps), self.LENGTH_M / max(airspeed_mps, 5.0)
        self._north, self._east, self._down = (GaussMarkov(rng, sigma * share, tau) for share in (1.0, 1.0, 0.5))

    def step(self, dt_s: float) -> tuple[float, float, float]:
        """Advance and return the wind, north, east, down, m/s (where the air goes to)."""
        return (
            self._mean[0] + self._north.step(dt_s),
            self._mean[1] + self._east.step(dt_s),
            self._mean[2] + self._down.step(dt_s),
        )
