"""The forces of a second, and the autopilot's velocities of that second (for drag_velocity.py)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.velocity.rotor_drag import Felt
from visloc_companion.geo import se3
from visloc_companion.types import Quat, Vec3

WINDOW_NS = 1_000_000_000
MAX_GAP_NS = 150_000_000
MAX_TURN_COS = math.cos(math.radians(20.0) / 2)
"""Of half the angle: where the attitude turns further within a second its mean force has no axis."""
MIN_HEIGHT_M = 3.0
"""On the ground an accelerometer feels what the vehicle stands on."""


@dataclass(frozen=True, slots=True, eq=False)
class Second:
    """What was felt in a second and the autopilot's mean velocity; `alone`: that rests on no GNSS that is trusted."""

    felt: Felt
    v_ned_mps: Vec3
    alone: bool


class Forces:
    """Gathers a second's specific forces, and the autopilot's velocities of that second."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin another second."""
        self._from_ns: int | None = None
        self._until_ns, self._n, self._sum = 0, 0, [0.0, 0.0]
        self._q_from: Quat = (1.0, 0.0, 0.0, 0.0)
        self._q_mid: Quat | None = None
        self._v_sum, self._n_v, self._alone = [0.0, 0.0, 0.0], 0, False

    def on_velocity(self, v_ned_mps: Vec3, *, alone: bool) -> None:
        """Take the autopilot's velocity; `alone`: it rests on no GNSS that is trusted."""
        self._alone |= alone
        self._n_v += 1
        for k in range(3):
            self._v_sum[k] += v_ned_mps[k]

    def on_force(self, t_boot_ns: int, force_frd_mps2: Vec3, q_ned_frd: Quat) -> Second | None:
        """Take a specific force and the attitude of its time; the second that it completes, where that has one axis."""
        if self._from_ns is not None and t_boot_ns <= self._until_ns:
            return None
        if self._from_ns is None or t_boot_ns - self._until_ns > MAX_GAP_NS:
            self.clear()
            self._from_ns, self._q_from = t_boot_ns, q_ned_frd
        self._until_ns, self._n = t_boot_ns, self._n + 1
        self._sum[0] += force_frd_mps2[0]
        self._sum[1] += force_frd_mps2[1]
        if self._q_mid is None and t_boot_ns - self._from_ns >= WINDOW_NS // 2:
            self._q_mid = q_ned_frd
        if t_boot_ns - self._from_ns < WINDOW_NS:
            return None
        second = self._second(self._from_ns, q_ned_frd)
        self.clear()
        return second

    def _second(self, from_ns: int, q_ned_frd: Quat) -> Second | None:
        if self._q_mid is None or self._n_v == 0 or abs(np.dot(self._q_from, q_ned_frd)) < MAX_TURN_COS:
            return None
        middle_ns = (from_ns + self._until_ns) // 2
        felt = Felt(middle_ns, np.array(self._sum) / self._n, se3.R_from_quat(self._q_mid)[:, :2].T)
        north, east, down = (v / self._n_v for v in self._v_sum)
        return Second(felt, (north, east, down), self._alone)
