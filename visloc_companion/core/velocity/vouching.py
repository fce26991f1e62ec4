"""How far the autopilot's velocity is to be believed while the autopilot itself does not vouch for it.

A velocity that may be believed and a position that may be believed are two things: on the ground, or with optical flow, there is
the first without the second. Without any aiding an estimator goes on from its accelerations: PX4's velocity drifted by 24 m/s in
100 s of hovering. A velocity that was vouched for is therefore believed less and less (UNAIDED_SIGMA_MPS and DRIFT_MPS2 since
then); beyond MOST_MPS, or where the autopilot never vouched for one, none is taken (`Drive.NONE`): the vehicle moves as vehicles
do, and fixes and odometry tell how. That stays so for a while where the autopilot begins to vouch on positions that it is sent:
it takes seconds to find its velocity from them.
"""

from __future__ import annotations

from typing import NamedTuple

from visloc_companion.core.filter.fusion import UNAIDED_SIGMA_MPS
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.types import EstimatorStatus, Vec3

DRIFT_MPS2 = 0.25
"""Growth of the 1-sigma of a velocity that is only integrated: a tilt of 1.5 degrees."""
MOST_MPS = 12.0
"""1-sigma of the velocity of a vehicle of which nothing is known, on each axis."""
UNTRUSTED_MPS = 2.0
"""A velocity input whose own 1-sigma is above this may be none at all (an autopilot without any position reports zero)."""


def velocity_sigma_mps(stated_mps: float) -> float:
    """1-sigma of a velocity input that carries a place, m/s, from what is stated of it."""
    return stated_mps if stated_mps <= UNTRUSTED_MPS else MOST_MPS


class Believed(NamedTuple):
    """A velocity (NED, m/s) with the 1-sigma of its horizontal part, and what it is; without one that part is zero."""

    v_ned_mps: Vec3
    sigma_mps: float
    drive: Drive


class Vouching:
    """Remembers when the autopilot last vouched for its velocity."""

    def __init__(self) -> None:
        self._status: EstimatorStatus | None = None
        self._vouched_ns: int | None = None
        self._none = False

    def on_status(self, status: EstimatorStatus) -> None:
        """Take what the autopilot's estimator says of itself."""
        self._status = status
        if status.velocity_ok:
            self._vouched_ns = status.t_rx_ns

    def forget(self) -> None:
        """The autopilot restarted: what it vouched for is past."""
        self._vouched_ns = None

    def judged(self, v_ned_mps: Vec3, t_rx_ns: int, sigma_mps: float, drive: Drive, *, settled: bool = True) -> Believed:
        """What is believed of a velocity that arrived at a time, which is worth `sigma_mps` where the autopilot vouches for it.

        `settled`: whether an autopilot that is sent positions has had the time to find its velocity from them. A log whose
        autopilot says nothing of its velocity is judged by its position.
        """
        believed = self._vouched(v_ned_mps, t_rx_ns, sigma_mps, drive)
        if self._none and believed.drive is Drive.FED_BACK and not settled:
            return _nothing(v_ned_mps)
        self._none = believed.drive is Drive.NONE
        return believed

    def _vouched(self, v_ned_mps: Vec3, t_rx_ns: int, sigma_mps: float, drive: Drive) -> Believed:
        status = self._status
        if status is None or status.velocity_ok or (status.velocity_ok is None and status.horizontal_position_ok):
            return Believed(v_ned_mps, sigma_mps, drive)
        if status.velocity_ok is None:
            return Believed(v_ned_mps, max(sigma_mps, UNAIDED_SIGMA_MPS), drive)
        if self._vouched_ns is not None:
            drifted_mps = UNAIDED_SIGMA_MPS + DRIFT_MPS2 * max(0, t_rx_ns - self._vouched_ns) * 1e-9
            if drifted_mps < MOST_MPS:
                return Believed(v_ned_mps, max(sigma_mps, drifted_mps), drive)
        return _nothing(v_ned_mps)


def _nothing(v_ned_mps: Vec3) -> Believed:
    return Believed((0.0, 0.0, v_ned_mps[2]), MOST_MPS, Drive.NONE)
