"""How far the vehicle came between two frames: by odometry where the camera followed the ground, else by the velocity input."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from visloc_companion.core.odometry import OdometryTrack
from visloc_companion.core.places import hypotheses
from visloc_companion.core.places.hypotheses import Hypothesis, Travel
from visloc_companion.types import Odometry, Vec2

SPAN_NS = 40_000_000_000
INTERVAL_NS = 50_000_000
WALK_M2_PER_S = 0.05
"""Variance per axis that the integration of a velocity gains."""
MAX_UNSEEN_S = 0.5
"""Odometry with a longer hole is not used."""


class TravelLog:
    """Velocity samples and displacements of the last SPAN_NS, in the order of their times.

    `displacements`: those of another log, which takes them for both.
    """

    def __init__(self, displacements: OdometryTrack | None = None) -> None:
        self._points: deque[tuple[int, float, float, Vec2]] = deque()
        self.displacements = OdometryTrack() if displacements is None else displacements

    def velocity(self, t_ns: int, v_ne_mps: Vec2) -> None:
        """Take a velocity (m/s); one that is hardly newer than the last is left out."""
        if not self._points:
            self._points.append((t_ns, 0.0, 0.0, v_ne_mps))
            return
        t0, north, east, (v_n, v_e) = self._points[-1]
        if t_ns - t0 < INTERVAL_NS:
            return
        dt_s = (t_ns - t0) * 1e-9
        north, east = north + dt_s * (v_n + v_ne_mps[0]) / 2, east + dt_s * (v_e + v_ne_mps[1]) / 2
        self._points.append((t_ns, north, east, v_ne_mps))
        while self._points[0][0] < t_ns - SPAN_NS:
            self._points.popleft()

    def odometry(self, seen: Odometry) -> None:
        """Take what the camera saw of its own motion."""
        self.displacements.add(seen)

    def between(self, t_from_ns: int, t_to_ns: int) -> Travel:
        """From one time to a later one; without any velocity the vehicle is taken to stand (its error covers what it does)."""
        dt_s = max(0, t_to_ns - t_from_ns) * 1e-9
        newest = self.displacements.newest_ns
        if newest is not None and t_from_ns <= t_to_ns <= newest:
            seen = self.displacements.between(t_from_ns, t_to_ns)
            if seen is not None and seen.unseen_s <= MAX_UNSEEN_S:
                north, east, _ = seen.displacement_ned_m
                return Travel((north, east), seen.cov_ne_m2, dt_s, by_velocity=False)
        start, end = self._at(t_from_ns), self._at(t_to_ns)
        walk = WALK_M2_PER_S * dt_s
        return Travel((end[0] - start[0], end[1] - start[1]), ((walk, 0.0), (0.0, walk)), dt_s, by_velocity=True)

    def carried(self, h: Hypothesis, t_ns: int) -> Hypothesis:
        """A hypothesis at a time, where that is later than its own."""
        return hypotheses.carried(h, t_ns, self.between(h.t_ns, t_ns)) if t_ns > h.t_ns else h

    def _at(self, t_ns: int) -> Vec2:
        """Place by the velocity since it began; before and after what is known the velocity is held."""
        if not self._points:
            return 0.0, 0.0
        k = max(1, bisect_right(self._points, t_ns, key=lambda point: point[0]))
        t0, north, east, (v_n, v_e) = self._points[k - 1]
        if k < len(self._points):
            v_n, v_e = ((a + b) / 2 for a, b in zip((v_n, v_e), self._points[k][3], strict=True))
        dt_s = (t_ns - t0) * 1e-9
        return north + dt_s * v_n, east + dt_s * v_e
