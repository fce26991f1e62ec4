"""Whether the autopilot's local and global positions still belong to the EKF origin that it told.

An origin that is moved in flight (SET_GPS_GLOBAL_ORIGIN to PX4) is told once, and may then be lost. Until it is asked
for again all that is sent would be about the old one, and PX4, which follows positions that it rejects after a second
(ev_pos_control.cpp), flies off by as much as the origin moved. LOCAL_POSITION_NED and GLOBAL_POSITION_INT tell it at once.
"""

from __future__ import annotations

import math

from visloc_companion.geo import wgs84
from visloc_companion.types import AutopilotKind, Event, GeoPoint, LocalPose, PriorPose

TOGETHER_NS = 150_000_000
"""Samples of both kinds that are no further apart are of one place; the velocity leads from one to the other."""
APART_M = 10.0
"""Further apart than a velocity that changes meanwhile has them: of 1,000 pairs in a log of a real ArduCopter (2015) none was by
more than 1.2 m."""


class OriginCheck:
    """Sans-IO. `doubted`: the positions belong to another origin, and the autopilot has not told one since that was seen.

    Where the estimate jumps between two samples that is so until the next one. Where it is so of the origin that is told upon it,
    it is the autopilot's affair, and no doubt until they have agreed again.
    """

    def __init__(self) -> None:
        self.doubted = self._excused = False
        self._local: LocalPose | None = None
        self._global: PriorPose | None = None

    def hear(self, event: Event, kind: AutopilotKind, origin: GeoPoint | None) -> bool:
        """Take an event of the link; whether the origin, as it was told, is doubted from now on."""
        if isinstance(event, LocalPose):
            self._local = event
        elif isinstance(event, PriorPose):
            self._global = event
        else:
            return False
        apart_m = None if origin is None or kind is AutopilotKind.UNKNOWN else self._apart_m(kind, origin)
        if apart_m is None:
            return False
        if apart_m <= APART_M:
            self.doubted = self._excused = False
            return False
        begins = not (self.doubted or self._excused)
        self.doubted = self.doubted or begins
        return begins

    def told(self) -> None:
        """The autopilot told its origin, the same one or another."""
        self._excused, self.doubted = self._excused or self.doubted, False

    def forget(self) -> None:
        """The autopilot may be another one when it is heard again."""
        self.doubted = self._excused = False
        self._local = self._global = None

    def _apart_m(self, kind: AutopilotKind, origin: GeoPoint) -> float | None:
        """How far the newest positions lie from each other, horizontally; None where they are of different times."""
        local, place = self._local, self._global
        if local is None or place is None or abs(local.t_boot_ns - place.t_boot_ns) > TOGETHER_NS:
            return None
        since_s = (place.t_boot_ns - local.t_boot_ns) * 1e-9
        expected_ne_m = [p + v * since_s for p, v in zip(local.p_ned_m[:2], local.v_ned_mps[:2], strict=True)]
        return math.dist(expected_ne_m, wgs84.autopilot_ned_from_geo(kind, place.place, origin)[:2])
