"""A velocity integrated from accelerations: what drives the filter while the autopilot's own velocity rests on what we inject.

The specific force of the accelerometers (SCALED_IMU, HIGHRES_IMU), turned by the autopilot's attitude and with gravity added, is
summed up by the trapezoidal rule. The sum begins at the autopilot's velocity of the last time at which that was to be believed
(`anchor`), and is then fed by nothing of ours; its errors are states of the filter (propagation.py). Times are the autopilot's.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from visloc_companion.core.velocity.inertial_bias import AccelerationBias
from visloc_companion.geo import se3
from visloc_companion.types import Quat, Vec2, Vec3

SPAN_NS = 3_000_000_000
MAX_GAP_NS = 150_000_000
"""Over a longer gap between samples the acceleration is not known, and the sum ends."""
MAX_AHEAD_NS = 100_000_000
"""The last acceleration is held for so long."""


class InertialVelocity:
    """Sums accelerations; `at` answers where samples reach without a gap from the anchor on."""

    def __init__(self) -> None:
        self._t_ns: deque[int] = deque()
        self._sum_ne_mps: deque[Vec2] = deque()
        self._last_ne_mps2: Vec2 = (0.0, 0.0)
        self._anchor: tuple[Vec2, Vec2] | None = None
        self._yaw_rad = 0.0
        self.bias = AccelerationBias()

    def clear(self) -> None:
        """Forget everything (the autopilot's clock stepped)."""
        self._t_ns.clear()
        self._sum_ne_mps.clear()
        self._anchor = None
        self.bias.interrupted()

    def on_force(self, t_boot_ns: int, force_frd_mps2: Vec3, q_ned_frd: Quat) -> None:
        """Take a specific force along the body's axes and the attitude of its time; one that is not later is dropped."""
        if self._t_ns and t_boot_ns <= self._t_ns[-1]:
            return
        (forward, right), (x, y, z) = self.bias.forward_right_mps2, force_frd_mps2
        north, east, _ = se3.rotate(q_ned_frd, (x - forward, y - right, z))
        _, _, self._yaw_rad = se3.euler_from_quat(q_ned_frd)
        if self._t_ns and t_boot_ns - self._t_ns[-1] > MAX_GAP_NS:
            self.clear()
        total = (0.0, 0.0)
        if self._t_ns:
            half_s = (t_boot_ns - self._t_ns[-1]) * 0.5e-9
            (n0, e0), (sum_n, sum_e) = self._last_ne_mps2, self._sum_ne_mps[-1]
            total = (sum_n + half_s * (n0 + north), sum_e + half_s * (e0 + east))
        self._t_ns.append(t_boot_ns)
        self._sum_ne_mps.append(total)
        self._last_ne_mps2 = (north, east)
        while self._t_ns[0] < t_boot_ns - SPAN_NS:
            self._t_ns.popleft()
            self._sum_ne_mps.popleft()

    def anchor(self, t_boot_ns: int, v_ne_mps: Vec2, *, teaches: bool = False) -> None:
        """Begin anew from a velocity, north and east m/s; one that rests on a trusted GNSS teaches the bias."""
        total = self._sum_at(t_boot_ns)
        self._anchor = None if total is None else (v_ne_mps, total)
        if total is None or not teaches:
            self.bias.interrupted()
        else:
            self.bias.on_sample(t_boot_ns, v_ne_mps, total, self._yaw_rad)

    def release(self) -> None:
        """There is no velocity to begin from."""
        self._anchor = None
        self.bias.interrupted()

    def at(self, t_boot_ns: int) -> Vec2 | None:
        """The velocity at a time, north and east m/s; None without an anchor or without samples."""
        total = self._sum_at(t_boot_ns)
        if self._anchor is None or total is None:
            return None
        (v_north, v_east), (north, east) = self._anchor
        return v_north + total[0] - north, v_east + total[1] - east

    def _sum_at(self, t_boot_ns: int) -> Vec2 | None:
        after = bisect_right(self._t_ns, t_boot_ns)
        if after == 0:
            return None
        t0_ns, (n0, e0) = self._t_ns[after - 1], self._sum_ne_mps[after - 1]
        if after == len(self._t_ns):
            ahead_s = (t_boot_ns - t0_ns) * 1e-9
            north, east = self._last_ne_mps2
            return (n0 + ahead_s * north, e0 + ahead_s * east) if t_boot_ns - t0_ns <= MAX_AHEAD_NS else None
        n1, e1 = self._sum_ne_mps[after]
        share = (t_boot_ns - t0_ns) / (self._t_ns[after] - t0_ns)
        return n0 + share * (n1 - n0), e0 + share * (e1 - e0)
