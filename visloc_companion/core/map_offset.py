"""How far the map seems to be from GNSS while GNSS is good: a shift that is more than GNSS explains may be the map's own.

Nobody can say which of the two is wrong, so positions are not corrected by it; but the covariance and the protection level of
what is stated later, by the map alone, must not claim the map's usual accuracy. A GNSS that once agreed with the map and then did
not was led away; where the two never agreed, the map may lie beside its place as well (georeferencing, datum).
"""

from __future__ import annotations

import math
from collections import deque

from visloc_companion.types import Command, Notice, Severity, Vec2

SPAN_NS = 120_000_000_000
SOILED_NS = 30_000_000_000
"""What was compared so shortly before GNSS became suspect may have been dragged already."""
FEWEST = 20
BORNE_OUT_BY = 5
"""So many fixes beside a trusted GNSS, with a mean that it explains: the map lies where it should. Fewer tell of no shift."""
MOST_M = 50.0
"""Georeferencing and datums are off by tens of metres; a GNSS that is further off is false."""
GNSS_SIGMA_M = 3.0
"""1-sigma of what GNSS is off by for minutes, on each axis."""
BEYOND_SIGMAS = 2.0


class MapOffset:
    """The mean difference of GNSS and fixes over the last two minutes of a good GNSS."""

    def __init__(self, map_sigma_m: float) -> None:
        self._map_sigma_m = map_sigma_m
        self._differences: deque[tuple[int, Vec2]] = deque()
        self._told = self._borne_out = False
        self.distance_m = 0.0
        """Length of the mean difference, 0 while too little is known."""

    def compared(self, t_ns: int, gnss_minus_fix_m: Vec2) -> None:
        """Take the difference of a trusted GNSS and an accepted fix."""
        self._differences.append((t_ns, gnss_minus_fix_m))
        while self._differences[0][0] < t_ns - SPAN_NS:
            self._differences.popleft()
        self._average()

    def suspected(self, t_ns: int, t_fix_ns: int, gnss_minus_fix_m: Vec2) -> None:
        """GNSS is suspect since a time; take how far from it the newest fix is, which counts until the map was borne out."""
        if not self._borne_out:
            self.compared(t_fix_ns, gnss_minus_fix_m)
            return
        while self._differences and self._differences[-1][0] > t_ns - SOILED_NS:
            self._differences.pop()
        self._average()

    def _average(self) -> None:
        n = len(self._differences)
        sums = (math.fsum(d[axis] for _, d in self._differences) for axis in range(2))
        mean_m = math.hypot(*(total / n for total in sums)) if n else 0.0
        self._borne_out |= n >= BORNE_OUT_BY and mean_m <= self._explained_m
        known = n >= FEWEST if self._borne_out else n >= BORNE_OUT_BY and mean_m <= MOST_M
        self.distance_m = mean_m if known else 0.0

    @property
    def _explained_m(self) -> float:
        return BEYOND_SIGMAS * math.hypot(GNSS_SIGMA_M, self._map_sigma_m)

    @property
    def sigma_m(self) -> float:
        """1-sigma of the map on each axis: as configured, or half the distance where GNSS does not explain that."""
        distance_m = self.distance_m
        return self._map_sigma_m if distance_m <= self._explained_m else max(self._map_sigma_m, distance_m / 2)

    def notices(self) -> list[Command]:
        """The operator is told once."""
        if self._told or self.sigma_m <= self._map_sigma_m:
            return []
        self._told = True
        text = f"visloc: map is {self.distance_m:.0f} m off GNSS"
        return [Notice(Severity.WARNING, text, to_operator=True, data=(("distance_m", self.distance_m),))]
