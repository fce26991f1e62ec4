"""How large the tiles are that a worker is asked to search: smaller after one that cost it its life, and larger again later.

What killed it may be the tile (a computer too slow, or with too little memory for it) or something else (another program took
the memory, somebody ended it). So after a while the next larger size is tried, once; where that costs the worker again, the
while doubles.
"""

from __future__ import annotations

FIRST_WAIT_NS, LONGEST_WAIT_NS = 60_000_000_000, 960_000_000_000
"""A worker is told of as failing after three losses in a minute; a computer too small for the size loses one in a quarter of an
hour in the end."""


class TileSize:
    """The largest radius that is asked for, metres: `usual_m`, halved with each loss down to `least_m`, doubled after a wait."""

    def __init__(self, usual_m: float, least_m: float) -> None:
        self._usual_m, self._least_m = usual_m, least_m
        self.radius_m = usual_m
        self._wait_ns, self._grow_ns, self._grown_ns = FIRST_WAIT_NS, 0, -(2**62)

    def lost(self, radius_m: float, now_ns: int) -> None:
        """A tile of a radius cost the worker its life."""
        soon = now_ns - self._grown_ns < self._wait_ns
        self._wait_ns = min(2 * self._wait_ns, LONGEST_WAIT_NS) if soon else FIRST_WAIT_NS
        self.radius_m = min(self._usual_m, max(self._least_m, radius_m / 2))
        self._grow_ns, self._grown_ns = now_ns + self._wait_ns, -(2**62)

    def may_grow(self, t_ns: int) -> bool:
        """Whether the next larger size is to be tried in a frame of this time."""
        return self.radius_m < self._usual_m and t_ns >= self._grow_ns

    def grow(self, t_ns: int) -> None:
        """Try it; the next one only after another wait."""
        self.radius_m = min(self._usual_m, 2 * self.radius_m)
        self._grow_ns, self._grown_ns = t_ns + self._wait_ns, t_ns
