"""Whether measurements teach the filter the error of the velocity that drives it: only then may accelerations carry that.

Accelerations lose the velocity by the second, and begin with the autopilot's; while neither is told anything, the autopilot's own
is the better one.
"""

from __future__ import annotations

TAUGHT_BY, UNTAUGHT_LOSS = 2, 1.5
"""Accelerations drive the filter while the fix or interval of odometry before the last is no older than the time in which their
error would lose so many times the 1-sigma of the autopilot's own velocity."""
SETTLED_BY = 20
"""An autopilot that never had a trusted GNSS takes seconds to find its velocity from what we send: so many fixes or intervals
come before accelerations go on from it."""
SEEN_NS = 2_500_000_000
"""The air tells the velocity when nothing was recognised for so long."""


class Teaching:
    """Keeps when the filter was taught. `velocity_known`: the autopilot's velocity was known without us."""

    def __init__(self) -> None:
        self.velocity_known = False
        self._taught_ns: list[int] = []
        self._n_taught = self._seen_ns = 0

    @property
    def settled(self) -> bool:
        """Whether the autopilot's velocity was known without us, or has had the time to come right by what we send."""
        return self.velocity_known or self._n_taught >= SETTLED_BY

    def restarted(self) -> None:
        """The filter was seeded anew."""
        self._n_taught = 0

    def recognised(self, t_ns: int) -> None:
        """A fix or an interval of odometry of this time was taken."""
        self.told(t_ns)
        self._n_taught += 1
        self._seen_ns = max(self._seen_ns, t_ns)

    def told(self, t_ns: int) -> None:
        """Something told the velocity at a time; a late fix takes no place from later intervals."""
        self._taught_ns = sorted([*self._taught_ns, t_ns])[-TAUGHT_BY:]

    def lasts(self, t_ns: int, sigma_mps: float, sigma_a_mps2: float) -> bool:
        """Whether accelerations of an error may drive the filter at a time, beside an autopilot's velocity of this 1-sigma."""
        within_s = UNTAUGHT_LOSS * sigma_mps / sigma_a_mps2
        lately = len(self._taught_ns) == TAUGHT_BY and t_ns - self._taught_ns[0] <= within_s * 1e9
        return lately and self.settled

    def blind(self, t_ns: int) -> bool:
        """Whether nothing was recognised for a while."""
        return t_ns - self._seen_ns > SEEN_NS
