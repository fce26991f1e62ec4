"""What the accelerations get wrong, learned while GNSS is trusted: their sum against the autopilot's velocity, window by window.

The mean error of a window along forward and right is one sample of a bias (sensor, levelling) that stays; how far samples are
from it tells how much the error changes from window to window, which becomes the filter's 1-sigma (propagation.py).
"""

from __future__ import annotations

import math

from visloc_companion.geo.se3 import wrap_pi
from visloc_companion.types import Vec2

WINDOW_NS = 5_000_000_000
LONGEST_WINDOW_NS = 6_000_000_000
MAX_TURN_RAD = math.radians(30.0)
"""A window in which the vehicle turns further belongs to no single direction of the body."""
MEMORY = 24
"""Windows that the running means reach back over."""
ENOUGH = 6
SAFETY = 1.3
"""Few windows tell their scatter poorly: 6 samples of a Gaussian claim less than 1/1.3 of it in one case of 5."""


class AccelerationBias:
    """Running means of the error along forward and right, m/s²."""

    def __init__(self) -> None:
        self.forward_right_mps2: Vec2 = (0.0, 0.0)
        self._n, self._mean_square = 0, 0.0
        self._begun: tuple[int, Vec2, Vec2, float] | None = None

    def sigma_mps2(self, at_most: float, at_least: float) -> float:
        """1-sigma of what is left, within bounds; the upper one until enough is known."""
        if self._n < ENOUGH:
            return at_most
        return min(at_most, max(at_least, SAFETY * math.sqrt(self._mean_square)))

    def interrupted(self) -> None:
        """The window under way tells nothing."""
        self._begun = None

    def on_sample(self, t_boot_ns: int, v_ne_mps: Vec2, sum_ne_mps: Vec2, yaw_rad: float) -> None:
        """Take the autopilot's velocity and the sum of the accelerations of the same time (their bias taken off so far)."""
        if self._begun is None:
            self._begun = (t_boot_ns, v_ne_mps, sum_ne_mps, yaw_rad)
            return
        t0_ns, v0, sum0, yaw0 = self._begun
        if t_boot_ns - t0_ns < WINDOW_NS:
            return
        self._begun = (t_boot_ns, v_ne_mps, sum_ne_mps, yaw_rad)
        turned = wrap_pi(yaw_rad - yaw0)
        if t_boot_ns - t0_ns > LONGEST_WINDOW_NS or abs(turned) > MAX_TURN_RAD:
            return
        seconds = (t_boot_ns - t0_ns) * 1e-9
        north = (sum_ne_mps[0] - sum0[0] - v_ne_mps[0] + v0[0]) / seconds
        east = (sum_ne_mps[1] - sum0[1] - v_ne_mps[1] + v0[1]) / seconds
        c, s = math.cos(yaw0 + turned / 2), math.sin(yaw0 + turned / 2)
        self._learn(c * north + s * east, c * east - s * north)

    def _learn(self, forward: float, right: float) -> None:
        self._n += 1
        share = max(1 / self._n, 1 / MEMORY)
        if self._n > 1:  # the first sample is the bias itself
            self._mean_square += max(1 / (self._n - 1), 1 / MEMORY) * ((forward**2 + right**2) / 2 - self._mean_square)
        was_forward, was_right = self.forward_right_mps2
        self.forward_right_mps2 = (was_forward + share * forward, was_right + share * right)
