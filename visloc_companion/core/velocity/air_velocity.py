"""The velocity that the air tells: by a copter's drag (drag_velocity.py) or a plane's pitot tube (pitot.py).

While the velocity is known it teaches wind and sensor; where nothing is recognised any more it holds the velocity that is
integrated from accelerations. What it gets wrong for long is a pair of the position filter's states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core.filter.belief import Belief, renewed, widened_by
from visloc_companion.core.filter.fusion import taken
from visloc_companion.core.filter.propagation import AIR, HEADING, N_STATES, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Accepted, FloatArray, Rejected, Vec2

H_AIR: FloatArray = np.eye(N_STATES)[AIR] - np.eye(N_STATES)[VELOCITY]
"""The velocity that the air tells, less the driving one: the error of the former less that of the latter."""
LEAST_M2PS2 = 1e-4
GUSTS_LAST = 0.4
"""Share of what a second's velocity scatters by that the next seconds have, too: a gust of 200 m goes by in 10 to 20 s. Chosen on
two of a simulated copter's flights (decision 77)."""
HOLDS_MPS = 1.5
"""A velocity known as well as that (1-sigma) holds the velocity that is integrated from accelerations."""


@dataclass(frozen=True, slots=True, eq=False)
class AirVelocity:
    """Velocity (north, east) about a time, m/s. Its error that lasts has the covariance `error` (2, 2); since the sample before
    it has `doubt` (2, 2) more, None where there was none since something was learned. `noise` (2, 2) is new in each. `turning`:
    derivative by the heading error."""

    t_boot_ns: int
    v_ne_mps: Vec2
    noise_m2ps2: FloatArray
    error_m2ps2: FloatArray
    doubt_m2ps2: FloatArray | None
    turning: Vec2

    @property
    def holds(self) -> bool:
        """Whether it is known well enough to hold one that is integrated from accelerations."""
        return float(np.linalg.eigvalsh(self.error_m2ps2)[-1]) <= HOLDS_MPS**2


@dataclass(frozen=True, slots=True, eq=False)
class AirError:
    """The velocity that the air tells at a time, less the driving one (2,), m/s."""

    t_ns: int
    off_ne_mps: Vec2
    told: AirVelocity


def gusty(told: AirVelocity, since_s: float) -> AirVelocity:
    """The same where gusts, of which its noise is made, last in part since a sample so many seconds before."""
    if told.doubt_m2ps2 is None:
        return told
    more = GUSTS_LAST * since_s * min(since_s, 1.0) * told.noise_m2ps2
    return replace(told, doubt_m2ps2=told.doubt_m2ps2 + more)


def observed(belief: Belief, z: AirError, settings: NavigatorSettings) -> tuple[Belief, Accepted | Rejected]:
    """The belief after a sample. Beside any velocity but one that is integrated from accelerations it says nothing."""
    if belief.drive is not Drive.INERTIAL:
        return belief, Accepted(0.0)
    told = z.told
    if told.doubt_m2ps2 is None:
        belief = renewed(belief, AIR, LEAST_M2PS2)
    more, H = np.zeros((N_STATES, N_STATES)), H_AIR.copy()
    more[AIR, AIR] = told.error_m2ps2 if told.doubt_m2ps2 is None else told.doubt_m2ps2
    H[:, HEADING] = told.turning
    return taken(widened_by(belief, more), np.array(z.off_ne_mps), told.noise_m2ps2, H, settings.gate_sigma)
