"""The receiver's last positions: how far it moved between two times, and where it was beside a fix, which comes later."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, Vec2, Vec3

SPAN_NS = 15_000_000_000
MAX_GAP_NS = 1_500_000_000
"""Positions further apart are not interpolated, and none is moved by the velocity for longer."""
DUE_INTERVALS = 2
"""Nor is one for longer than so many of the receiver's intervals: then it has nothing to say, and a plane in a turn is 10 m away
from where it would have gone in 1.5 s."""


@dataclass(frozen=True, slots=True)
class _Point:
    """A position at its time of validity; `stretch` counts how often the receiver had lost its fix before."""

    t_ns: int
    place: GeoPoint
    stretch: int


class GnssTrack:
    """Positions of the last SPAN_NS."""

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()
        self._stretch = 0

    def interrupted(self) -> None:
        """The fix was lost: no displacement reaches from before this moment to after it."""
        self._stretch += 1

    def add(self, t_ns: int, place: GeoPoint) -> None:
        """Take a position at its time of validity; one that is not newer is left out."""
        if self._points and t_ns <= self._points[-1].t_ns:
            return
        self._points.append(_Point(t_ns, place, self._stretch))
        while self._points[0].t_ns < t_ns - SPAN_NS:
            self._points.popleft()

    @property
    def newest(self) -> GeoPoint | None:
        """The last position, None before the first."""
        return self._points[-1].place if self._points else None

    @property
    def newest_ns(self) -> int | None:
        """Time of the last position, None before the first and since the fix was lost."""
        return self._points[-1].t_ns if self._points and self._points[-1].stretch == self._stretch else None

    def displacement(self, t_from_ns: int, t_to_ns: int) -> Vec2 | None:
        """How far the receiver moved, north and east metres; None where no positions of one stretch lie about both times."""
        if not self._points:
            return None
        origin = self._points[0].place
        start, end = self._around(t_from_ns), self._around(t_to_ns)
        if start is None or end is None or start[0].stretch != end[1].stretch:
            return None
        (n0, e0), (n1, e1) = _between(*start, t_from_ns, origin), _between(*end, t_to_ns, origin)
        return n1 - n0, e1 - e0

    def minus(self, fix: Fix, v_ned_mps: Vec3) -> Vec2 | None:
        """GNSS minus a fix at the fix's image time, north and east metres; None where no position is near that time, or the
        receiver had lost its fix then.

        Between two positions it interpolates; outside of them it moves the nearest one by the velocity.
        """
        k = bisect_right(self._points, fix.t_ns, key=_time)
        about = [i for i in (k - 1, k) if 0 <= i < len(self._points)]
        near = [i for i in about if abs(self._points[i].t_ns - fix.t_ns) <= MAX_GAP_NS]
        if not near:
            return None
        if len(near) == 2:
            before, after = self._points[k - 1], self._points[k]
            lost = before.stretch != after.stretch and after.t_ns - before.t_ns > MAX_GAP_NS
            return None if lost else _between(before, after, fix.t_ns, fix.place)
        nearest = self._points[near[0]]
        lost = nearest.t_ns <= fix.t_ns and nearest.stretch != self._stretch
        if lost or abs(fix.t_ns - nearest.t_ns) > self._due_ns(near[0]):
            return None
        dt_s = (fix.t_ns - nearest.t_ns) * 1e-9
        north, east, _ = wgs84.ned_from_geo(nearest.place, fix.place)
        return north + v_ned_mps[0] * dt_s, east + v_ned_mps[1] * dt_s

    def _due_ns(self, at: int) -> int:
        """For how long about a position another one of its stretch was due."""
        point = self._points[at]
        beside = [self._points[i] for i in (at - 1, at + 1) if 0 <= i < len(self._points)]
        intervals_ns = [abs(other.t_ns - point.t_ns) for other in beside if other.stretch == point.stretch]
        return DUE_INTERVALS * min(intervals_ns, default=MAX_GAP_NS)

    def _around(self, t_ns: int) -> tuple[_Point, _Point] | None:
        """The positions before and after a time in one stretch and no further apart than MAX_GAP_NS (twice the same one at its
        very time); None where there are none."""
        k = bisect_right(self._points, t_ns, key=_time)
        before = self._points[k - 1] if k else None
        if before is None or before.t_ns == t_ns:
            return None if before is None else (before, before)
        after = self._points[k] if k < len(self._points) else None
        if after is None or after.stretch != before.stretch or after.t_ns - before.t_ns > MAX_GAP_NS:
            return None
        return before, after


def _time(point: _Point) -> int:
    return point.t_ns


def _between(before: _Point, after: _Point, t_ns: int, origin: GeoPoint) -> Vec2:
    """The position at a time between two, north and east metres of a place."""
    n0, e0, _ = wgs84.ned_from_geo(before.place, origin)
    if before.t_ns == after.t_ns:
        return n0, e0
    n1, e1, _ = wgs84.ned_from_geo(after.place, origin)
    share = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
    return n0 + share * (n1 - n0), e0 + share * (e1 - e0)
