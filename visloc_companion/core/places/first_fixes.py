"""The first fixes of a flight, beside a GNSS that moved unlike the camera before anything was recognised: who is wrong is open.

Where GNSS is false, fixes move as odometry does. Where the camera is not mounted as configured (or its lens or the map's height
is wrong), odometry is off by a share of the way, and fixes lie beside the place, by what the axis is tilted by, but move as GNSS
does. So the first fixes are not taken before the vehicle has flown on and their motion says that GNSS is the false one. A fix
that lies where GNSS does is taken at once.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from visloc_companion.core.places.place_search import spacing_m
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, Vec2

LIKELIER = 10.0
"""By so much fixes must be likelier to move as odometry does than as GNSS does ..."""
ALIKE = 0.1
"""... unless these two differ by less than this share of the way now, as after a jump: a camera set up so wrongly that its fixes
lie tens of metres beside their place has odometry off by more."""
AGREES_SIGMA = 3.0
"""While GNSS has no position fixes must move as odometry does, within so many sigma."""
LIES_THERE_SIGMA, GNSS_SIGMA_M = 4.0, 3.0
"""A fix within so many sigma of GNSS contradicts it in nothing; 1-sigma of GNSS and of the map together, on each axis."""
LONGEST_NS = 10_000_000_000
"""A vehicle that hovers is not waited for longer."""
FORGET_NS = 20_000_000_000


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A fix, how far GNSS was from it (GNSS minus fix, m; None where it had no position), its variance per axis, and the way
    after which another one looks at other ground."""

    t_ns: int
    place: GeoPoint
    beside_ne_m: Vec2 | None
    var_m2: float
    spacing_m: float


class FirstFixes:
    """Remembers the fixes that wait."""

    def __init__(self, travel: TravelLog) -> None:
        """`travel`: how far the vehicle came by odometry, and where a frame gives none by the velocity that the filter knows,
        which odometry taught it; others keep it."""
        self._travel = travel
        self._waiting: deque[_Waiting] = deque()
        self.decided = False
        """Whether a fix was taken, or may be: the camera is set up well enough."""

    def taken(self) -> None:
        """A fix was taken."""
        self.decided = True
        self._waiting.clear()

    def waits(self, fix: Fix, gnss_minus_fix_m: Vec2 | None, height_m: float) -> bool:
        """Whether a fix is not to be taken yet; `gnss_minus_fix_m` at its time, None while GNSS has no position; `height_m`:
        above the origin."""
        if self.decided:
            return False
        var_m2 = (fix.cov_ne_m2[0][0] + fix.cov_ne_m2[1][1]) / 2
        now = _Waiting(fix.t_ns, fix.place, gnss_minus_fix_m, var_m2, spacing_m(fix, height_m))
        while self._waiting and now.t_ns - self._waiting[0].t_ns > FORGET_NS:
            self._waiting.popleft()
        self._waiting.append(now)
        self.decided = _lies_there(now) or self._gnss_is_false(now)
        return not self.decided

    def _gnss_is_false(self, now: _Waiting) -> bool:
        first = next(each for each in self._waiting if now.beside_ne_m is None or each.beside_ne_m is not None)
        travel = self._travel.between(first.t_ns, now.t_ns)
        (nn, _), (_, ee) = travel.cov_ne_m2
        var_m2 = first.var_m2 + now.var_m2 + (nn + ee) / 2
        north, east, _ = wgs84.ned_from_geo(now.place, first.place)
        unlike_odometry_m = math.dist((north, east), travel.moved_ne_m)
        hovers = now.t_ns - first.t_ns >= LONGEST_NS
        if math.hypot(north, east) < now.spacing_m and not hovers:
            return False
        if first.beside_ne_m is None or now.beside_ne_m is None:
            return unlike_odometry_m <= AGREES_SIGMA * math.sqrt(var_m2)
        unlike_gnss = now.beside_ne_m[0] - first.beside_ne_m[0], now.beside_ne_m[1] - first.beside_ne_m[1]
        by_gnss = north + unlike_gnss[0], east + unlike_gnss[1]
        if math.dist(by_gnss, travel.moved_ne_m) <= max(ALIKE * math.hypot(*by_gnss), math.sqrt(var_m2)):
            return True
        return math.hypot(*unlike_gnss) ** 2 - unlike_odometry_m**2 >= 2 * math.log(LIKELIER) * var_m2


def _lies_there(fix: _Waiting) -> bool:
    """Whether a fix contradicts GNSS in nothing."""
    within_m = LIES_THERE_SIGMA * math.sqrt(fix.var_m2 + GNSS_SIGMA_M**2)
    return fix.beside_ne_m is not None and math.hypot(*fix.beside_ne_m) <= within_m
