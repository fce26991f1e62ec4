"""Where the sun stands, kept from the frames that show it for those that do not.

Whoever localises a frame looks at the map under the sun of the frame (localise/mapped/light.py), which crowns and slopes show to
some 10 degrees, or not at all. It stands still for minutes.
"""

from __future__ import annotations

from collections import deque

from visloc_companion.geo.sun import turn_between_deg
from visloc_companion.types import Sun

KEPT_NS = 600_000_000_000
"""The sun goes 2.5 degrees in so long."""
FEWEST, MOST = 5, 15
ALIKE_DEG = 25.0
MAJORITY = 0.7
"""Share of the suns seen that must stand so near to the one that is believed."""


class SunMemory:
    """`known` is for the next request; `seen` learns."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, Sun]] = deque(maxlen=MOST)

    def seen(self, t_ns: int, sun: Sun) -> None:
        """A frame of this time, whose fix was believed, shows the sun here."""
        self._seen.append((t_ns, sun))

    def known(self, t_ns: int) -> Sun | None:
        """The sun at a time, where enough frames of the last minutes agree on it."""
        suns = [sun for at_ns, sun in self._seen if abs(t_ns - at_ns) <= KEPT_NS]
        if len(suns) < FEWEST:
            return None
        middle = min(suns, key=lambda sun: sum(turn_between_deg(sun, other) for other in suns))
        alike = [sun for sun in suns if turn_between_deg(sun, middle) <= ALIKE_DEG]
        if len(alike) < MAJORITY * len(suns):
            return None
        return Sun(middle.azimuth_deg, sorted(sun.elevation_deg for sun in alike)[len(alike) // 2])
