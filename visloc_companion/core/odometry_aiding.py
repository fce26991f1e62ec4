"""From displacements between frames to intervals that the filter learns its velocity's error from, each used once."""

from __future__ import annotations

from visloc_companion.core.motion import Motion
from visloc_companion.core.odometry import OdometryTrack
from visloc_companion.types import Odometry

INTERVAL_NS = 500_000_000
"""Shorter ones are mostly noise."""
LONGEST_NS = 3_000_000_000
"""Over a longer one, the velocity's error may have changed, and the filter's memory ends."""
LEAST_VARIANCE_M2 = 1e-4


class OdometryAiding:
    """Cuts odometry into intervals one after the other."""

    def __init__(self) -> None:
        self._track = OdometryTrack()
        self._since_ns: int | None = None

    def on_odometry(self, event: Odometry) -> Motion | None:
        """Take a displacement; the interval that it completes, if it does. Those of frames that were not seen are left out."""
        before_ns = self._track.newest_ns
        self._track.add(event)
        newest_ns = self._track.newest_ns
        if newest_ns is None or newest_ns == before_ns:
            return None
        since_ns = event.t_from_ns if self._since_ns is None else self._since_ns
        self._since_ns = since_ns
        if newest_ns - since_ns < INTERVAL_NS:
            return None
        self._since_ns = newest_ns
        travelled = self._track.between(since_ns, newest_ns)
        if travelled is None or travelled.unseen_s > 0 or newest_ns - since_ns > LONGEST_NS:
            return None
        north, east, _ = travelled.displacement_ned_m
        (nn, ne), (_, ee) = travelled.own_ne_m2
        own = ((nn + LEAST_VARIANCE_M2, ne), (ne, ee + LEAST_VARIANCE_M2))
        return Motion(newest_ns, since_ns, (north, east), own, event.sigma_scale, event.sigma_heading_rad)
