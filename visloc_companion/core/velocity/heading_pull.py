"""What something other than the gyroscopes turns the autopilot's heading by: a compass beside iron or a power line, a reset.

The heading of two attitudes differs by what the body's rates add up to and by what the autopilot corrected. What it corrected
since the last fixes is how far its heading may be off by now beyond what is claimed of it: fixes bear out a heading, and
accelerations have nothing newer, nor have displacements where pictures show no turn. A pull may as well have set an error right,
so nothing is turned back; it is only known less well.
"""

from __future__ import annotations

import math
from dataclasses import replace

from visloc_companion.geo import se3
from visloc_companion.types import Odometry, Quat, Vec3

TAU_S = 100.0
"""As long as the heading's own error lasts (propagation.SLOW): gyroscopes that are off themselves add up to no more."""
MAX_GAP_NS = 150_000_000
"""Between attitudes that are further apart rates do not tell how the vehicle turned: four a second, as logged of a plane, are off
by 12 degrees in a minute (95 %), ten a second, of a copter, by 2.5."""
STEEPEST_RAD = math.radians(75.0)
FIXES = 5
"""The worker turns displacements by the median heading of so many (localise/odometry/true_heading.py)."""


class HeadingPull:
    """Adds the pull up. `since_fixes_rad`: the most that it has changed by since one of the last image fixes that were taken."""

    def __init__(self) -> None:
        self._last: tuple[int, float, float] | None = None
        self._pull_rad = 0.0
        self._at_fixes_rad = [0.0]
        self._told_rad2 = 0.0

    @property
    def since_fixes_rad(self) -> float:
        """At least zero."""
        return max([abs(self._pull_rad - then) for then in self._at_fixes_rad])

    def on_attitude(self, t_boot_ns: int, q_ned_frd: Quat, rate_frd_radps: Vec3) -> None:
        """Take an attitude with its body rates; times increase."""
        roll, pitch, yaw = se3.euler_from_quat(q_ned_frd)
        if abs(pitch) > STEEPEST_RAD:
            self.interrupted()
            return
        _, y, z = rate_frd_radps
        turning_radps = (y * math.sin(roll) + z * math.cos(roll)) / math.cos(pitch)
        before, self._last = self._last, (t_boot_ns, yaw, turning_radps)
        if before is None or not 0 < t_boot_ns - before[0] <= MAX_GAP_NS:
            return
        dt_s = (t_boot_ns - before[0]) * 1e-9
        pulled = yaw - before[1] - (turning_radps + before[2]) / 2 * dt_s
        kept = math.exp(-dt_s / TAU_S)
        self._pull_rad = kept * self._pull_rad + math.remainder(pulled, 2 * math.pi)
        self._at_fixes_rad = [kept * then for then in self._at_fixes_rad]

    def interrupted(self) -> None:
        """What comes next does not follow on what came before."""
        self._last = None

    def borne_out(self) -> None:
        """An image fix was taken, which found the heading, too."""
        self._at_fixes_rad = [*self._at_fixes_rad[1 - FIXES :], self._pull_rad]
        self._told_rad2 = min(self._told_rad2, self.since_fixes_rad**2)

    def more_rad2(self) -> float:
        """By how much the variance of the heading has grown since this was asked last."""
        grown_rad2 = max(0.0, self.since_fixes_rad**2 - self._told_rad2)
        self._told_rad2 += grown_rad2
        return grown_rad2

    def doubted(self, seen: Odometry) -> Odometry:
        """A displacement that was turned by the heading, with what that may be off by."""
        more_rad2 = self.since_fixes_rad**2
        (north, east, _), ((nn, ne), (_, ee)) = seen.displacement_ned_m, seen.cov_ne_m2
        ne -= more_rad2 * north * east
        cov = (nn + more_rad2 * east**2, ne), (ne, ee + more_rad2 * north**2)
        return replace(seen, cov_ne_m2=cov, sigma_heading_rad=math.sqrt(seen.sigma_heading_rad**2 + more_rad2))
