"""The receiver's last positions as a track, for displacements over the intervals of odometry."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from visloc_companion.geo import wgs84
from visloc_companion.types import GeoPoint, Vec2

SPAN_NS = 15_000_000_000
MAX_GAP_NS = 1_500_000_000
"""Positions further apart are not interpolated."""


class GnssTrack:
    """Positions of the last SPAN_NS, kept in metres north and east of the first of them."""

    def __init__(self) -> None:
        self._origin: GeoPoint | None = None
        self._points: deque[tuple[int, float, float]] = deque()

    def clear(self) -> None:
        """Nothing before this moment is compared with what follows (the fix was lost)."""
        self._origin = None
        self._points.clear()

    def add(self, t_ns: int, place: GeoPoint) -> None:
        """Take a position at its time of validity; one that is not newer is left out."""
        if self._points and t_ns <= self._points[-1][0]:
            return
        if self._origin is None:
            self._origin = place
        north, east, _ = wgs84.ned_from_geo(place, self._origin)
        self._points.append((t_ns, north, east))
        while self._points[0][0] < t_ns - SPAN_NS:
            self._points.popleft()

    @property
    def newest_ns(self) -> int | None:
        """Time of the last position, None without any."""
        return self._points[-1][0] if self._points else None

    def displacement(self, t_from_ns: int, t_to_ns: int) -> Vec2 | None:
        """How far the receiver moved, north and east metres; None where no positions lie about both times."""
        start, end = self._at(t_from_ns), self._at(t_to_ns)
        return None if start is None or end is None else (end[0] - start[0], end[1] - start[1])

    def _at(self, t_ns: int) -> Vec2 | None:
        k = bisect_right(self._points, t_ns, key=lambda point: point[0])
        if k == 0:
            return None
        t0, north, east = self._points[k - 1]
        if t0 == t_ns:
            return north, east
        if k == len(self._points):
            return None
        t1, north_1, east_1 = self._points[k]
        if t1 - t0 > MAX_GAP_NS:
            return None
        share = (t_ns - t0) / (t1 - t0)
        return north + share * (north_1 - north), east + share * (east_1 - east)
