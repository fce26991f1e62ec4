"""The velocity that a multicopter's drag tells, second by second, beside the velocity that drives the position filter.

What it gets wrong for long takes the place of the wind among the filter's states, which a plane's velocity through the air has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.airspeed import H_AIR
from visloc_companion.core.belief import Belief, renewed, widened_by
from visloc_companion.core.drag_velocity import DragVelocity
from visloc_companion.core.fusion import taken
from visloc_companion.core.propagation import HEADING, N_STATES, WIND, Drive
from visloc_companion.core.rotor_drag import Felt
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import se3
from visloc_companion.types import Accepted, Quat, Rejected, Vec2, Vec3

WINDOW_NS = 1_000_000_000
MAX_GAP_NS = 150_000_000
MAX_TURN_COS = math.cos(math.radians(20.0) / 2)
"""Of half the angle: where the attitude turns further within a window its mean force has no axis."""
MIN_HEIGHT_M = 3.0
"""On the ground an accelerometer feels what the vehicle stands on."""
LEAST_M2PS2 = 1e-4
HOLDS_MPS = 1.5
"""A velocity known as well as that (1-sigma) holds the velocity that is integrated from accelerations."""


@dataclass(frozen=True, slots=True, eq=False)
class Second:
    """What was felt in a second and the autopilot's mean velocity; `alone`: that rests on no GNSS that is trusted."""

    felt: Felt
    v_ned_mps: Vec3
    alone: bool


@dataclass(frozen=True, slots=True, eq=False)
class DragError:
    """The velocity that drag tells at a time, less the driving one (2,), m/s."""

    t_ns: int
    off_ne_mps: Vec2
    told: DragVelocity


def observed(belief: Belief, z: DragError, settings: NavigatorSettings) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a sample. Beside any velocity but one that is integrated from accelerations it says nothing."""
    if belief.drive is not Drive.INERTIAL:
        return belief, Accepted(0.0)
    told = z.told
    if told.doubt_m2ps2 is None:
        belief = renewed(belief, WIND, LEAST_M2PS2)
    more, H = np.zeros((N_STATES, N_STATES)), H_AIR.copy()
    more[WIND, WIND] = told.error_m2ps2 if told.doubt_m2ps2 is None else told.doubt_m2ps2
    H[:, HEADING] = told.turning
    return taken(widened_by(belief, more), np.array(z.off_ne_mps), told.noise_m2ps2, H, settings.gate_sigma)


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


def holds(found: DragVelocity) -> bool:
    """Whether a velocity by drag is known well enough to hold one that is integrated from accelerations."""
    return float(np.linalg.eigvalsh(found.error_m2ps2)[-1]) <= HOLDS_MPS**2
