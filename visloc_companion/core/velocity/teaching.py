"""Whether measurements teach the filter the error of the velocity that drives it: only then may accelerations carry that.

Accelerations lose the velocity by the second, and begin with the autopilot's; while neither is told anything, the autopilot's own
is the better one.
"""

from __future__ import annotations

import math

TAUGHT_BY, UNTAUGHT_LOSS = 2, 1.5
"""Accelerations drive the filter while the fix or interval of odometry before the last is no older than the time in which their
error would lose so many times the 1-sigma of the autopilot's own velocity."""
SETTLED_BY = 20
"""An autopilot that never had a trusted GNSS takes seconds to find its velocity from what we send: so many fixes or intervals
come before accelerations go on from it."""
SEEN_NS = 2_500_000_000
"""Where nothing was recognised for so long, nothing but the air tells the velocity."""
RARE_BY, RARE_NS = 2, 2_000_000_000
"""The air tells the velocity while fewer fixes or intervals than that were recognised in so long."""
AIR_FADES_NS = 10_000_000_000
"""So long after the air told the velocity what is known of it rests on that, and teaches nothing of the air."""


class Teaching:
    """Keeps when the filter was taught. `velocity_known`: the autopilot's velocity was known without us."""

    def __init__(self) -> None:
        self.velocity_known = False
        self._taught_ns: list[int] = []
        self._n_taught = 0
        self._seen_ns, self._air_told_ns = [0] * RARE_BY, -math.inf

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
        self._seen_ns = sorted([*self._seen_ns, t_ns])[-RARE_BY:]

    def air_told(self, t_ns: int) -> None:
        """The air told the velocity at a time."""
        self._air_told_ns = t_ns

    def told(self, t_ns: int) -> None:
        """Something told the velocity at a time; a late fix takes no place from later intervals."""
        self._taught_ns = sorted([*self._taught_ns, t_ns])[-TAUGHT_BY:]

    def lasts(self, t_ns: int, sigma_mps: float, sigma_a_mps2: float) -> bool:
        """Whether accelerations of an error may drive the filter at a time, beside an autopilot's velocity of this 1-sigma."""
        within_s = UNTAUGHT_LOSS * sigma_mps / sigma_a_mps2
        lately = len(self._taught_ns) == TAUGHT_BY and t_ns - self._taught_ns[0] <= within_s * 1e9
        return lately and self.settled

    def rare(self, t_ns: int) -> bool:
        """Whether too little was recognised lately to hold the velocity."""
        return t_ns - self._seen_ns[0] > RARE_NS

    def blind(self, t_ns: int) -> bool:
        """Whether nothing was recognised for a while."""
        return t_ns - self._seen_ns[-1] > SEEN_NS

    def since_air_s(self, t_ns: int) -> float:
        """Seconds since the air told the velocity, as far as its gusts count: where nothing is recognised their mean does."""
        return 0.0 if self.blind(t_ns) else min(t_ns - self._air_told_ns, AIR_FADES_NS) * 1e-9

    def own(self, t_ns: int) -> bool:
        """Whether what is known of the velocity rests on nothing that the air told."""
        return t_ns - self._air_told_ns > AIR_FADES_NS
