"""What the accelerations get wrong, learned while GNSS is trusted: their sum against the autopilot's velocity, window by window.

The mean error of a window along forward and right is one sample of a bias (sensor, levelling) that stays. How far samples are
from it tells how much the error changes in the long run. By how much samples that follow each other differ tells how fast: beyond
the filter's white noise it is laid to the Gauss-Markov process of the filter's correlation time whose means over such windows
differ as much. The larger of both becomes its 1-sigma (propagation.py). An attitude that errs by less, but anew every few
seconds, is as harmful between fixes as a larger error that stays.
"""

from __future__ import annotations

import math

from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S
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
MOST_MPS2 = 0.5
"""More than what PX4's own simulator shows, whose gyroscopes are far worse than any real ones."""


class AccelerationBias:
    """Running means of the error along forward and right, m/s²."""

    def __init__(self) -> None:
        self.forward_right_mps2: Vec2 = (0.0, 0.0)
        self._n, self._mean_square, self._n_changes, self._change_square = 0, 0.0, 0, 0.0
        self._last: tuple[int, Vec2] | None = None
        self._begun: tuple[int, Vec2, Vec2, float] | None = None

    def sigma_mps2(self, unknown: float, at_least: float, tau_s: float) -> float:
        """1-sigma of what is left, if it is thought to stay for `tau_s`; `unknown` until enough is known."""
        if self._n_changes < ENOUGH - 1:
            return unknown
        window_s = WINDOW_NS * 1e-9
        beyond_noise = max(0.0, self._change_square / 2 - INERTIAL_WALK_MPS_PER_SQRT_S**2 / window_s)
        variance = max(self._mean_square, beyond_noise / _change(window_s / tau_s))
        return min(MOST_MPS2, max(at_least, SAFETY * math.sqrt(variance)))

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
        self._learn(t_boot_ns, c * north + s * east, c * east - s * north)

    def _learn(self, t_boot_ns: int, forward: float, right: float) -> None:
        was_forward, was_right = self.forward_right_mps2
        last, self._last = self._last, (t_boot_ns, (was_forward + forward, was_right + right))
        self._n += 1
        share = max(1 / self._n, 1 / MEMORY)
        if last is not None and t_boot_ns - last[0] <= LONGEST_WINDOW_NS:
            self._n_changes += 1
            changed = (was_forward + forward - last[1][0]) ** 2 + (was_right + right - last[1][1]) ** 2
            self._change_square += max(1 / self._n_changes, 1 / MEMORY) * (changed / 2 - self._change_square)
        if self._n > 1:  # the first sample is the bias itself
            self._mean_square += max(1 / (self._n - 1), 1 / MEMORY) * ((forward**2 + right**2) / 2 - self._mean_square)
        self.forward_right_mps2 = (was_forward + share * forward, was_right + share * right)


def _change(x: float) -> float:
    """Variance of the mean of a Gauss-Markov process over a window of x correlation times less its covariance with that of the
    next window, over the variance of the process (from its autocorrelation exp(-t / tau))."""
    kept = -math.expm1(-x)
    return (2 * (x - kept) - kept * kept) / (x * x)
