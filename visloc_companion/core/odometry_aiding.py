"""From displacements between frames to intervals that follow each other, each used once.

Two ends of an interval err by what a frame's displacement errs by, however long it is. So for the filter an interval goes on
until that is no more than what accelerations, which carry the velocity meanwhile, lose in it; where the autopilot's own velocity
carries it, which may change its error at any moment, and for the GNSS monitor, which must be quick, all intervals are short.
"""

from __future__ import annotations

from dataclasses import dataclass

from visloc_companion.core.filter.motion import Motion
from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S
from visloc_companion.core.odometry import OdometryTrack
from visloc_companion.types import Odometry

INTERVAL_NS = 500_000_000
"""Shorter ones are mostly noise."""
ENOUGH_NS = 2_000_000_000
"""However uncertain the ends are, an interval of this length is told: the filter waits for it."""
LONGEST_NS = 3_000_000_000
"""Over a longer one, the velocity's error may have changed, and the filter's memory ends."""
LEAST_VARIANCE_M2 = 1e-4


@dataclass(frozen=True, slots=True)
class Intervals:
    """What a displacement completed: an interval for the filter, and one for the GNSS monitor."""

    of_filter: Motion | None = None
    of_monitor: Motion | None = None


class OdometryAiding:
    """Cuts odometry into intervals."""

    def __init__(self) -> None:
        self._track = OdometryTrack()
        self._filter, self._monitor = _Cutter(self._track), _Cutter(self._track)

    def on_odometry(self, event: Odometry, *, inertial_mps2: float | None) -> Intervals:
        """Take a displacement; `inertial_mps2`: accelerations with a slow error of this 1-sigma drive the filter. What was not
        seen is in no interval."""
        before_ns = self._track.newest_ns
        self._track.add(event)
        if self._track.newest_ns in (None, before_ns):
            return Intervals()
        return Intervals(self._filter.cut(event, before_ns, inertial_mps2), self._monitor.cut(event, before_ns))

    def lost(self) -> Motion | None:
        """The camera's motion is seen no more: what was seen of it and waited for a longer interval, for the filter."""
        return self._filter.rest()


class _Cutter:
    """Intervals of one consumer."""

    def __init__(self, track: OdometryTrack) -> None:
        self._track = track
        self._since_ns: int | None = None
        self._last: Odometry | None = None

    def cut(self, event: Odometry, before_ns: int | None, patient_mps2: float | None = None) -> Motion | None:
        """After another displacement; before it the track ended at `before_ns`. With an error of accelerations: `rest`."""
        self._last = event
        since_ns = self._since_ns = event.t_from_ns if self._since_ns is None else self._since_ns
        motion = self.rest(patient_mps2)
        if motion is None and self._since_ns != since_ns:  # not all of it was seen: what was, before the gap
            return self._seen(event, since_ns, before_ns)
        return motion

    def rest(self, patient_mps2: float | None = None) -> Motion | None:
        """What has been seen since the last interval, if it is long enough for one and, where accelerations of such an error
        carry the velocity meanwhile, worth it; nothing that was not seen waits."""
        newest_ns, since_ns = self._track.newest_ns, self._since_ns
        if self._last is None or since_ns is None or newest_ns is None or newest_ns - since_ns < INTERVAL_NS:
            return None
        motion = self._seen(self._last, since_ns, newest_ns)
        if motion is not None and patient_mps2 is not None and not _worth(motion, patient_mps2):
            return None
        self._since_ns = newest_ns
        return motion

    def _seen(self, event: Odometry, since_ns: int, until_ns: int | None) -> Motion | None:
        """An interval, if it is long enough and all of it was seen."""
        if until_ns is None or not INTERVAL_NS <= until_ns - since_ns <= LONGEST_NS:
            return None
        travelled = self._track.between(since_ns, until_ns)
        if travelled is None or travelled.unseen_s > 0:
            return None
        north, east, _ = travelled.displacement_ned_m
        (nn, ne), (_, ee) = travelled.own_ne_m2
        own = ((nn + LEAST_VARIANCE_M2, ne), (ne, ee + LEAST_VARIANCE_M2))
        shared = event.sigma_scale, event.sigma_heading_rad, event.sigma_focal
        return Motion(until_ns, since_ns, (north, east), own, *shared, travelled.per_focal_ne_m)


def _worth(motion: Motion, sigma_a_mps2: float) -> bool:
    """Whether a longer interval would tell little more of the velocity's error."""
    own_m2, dt = (motion.cov_ne_m2[0][0] + motion.cov_ne_m2[1][1]) / 2, motion.duration_s
    lost_m2 = INERTIAL_WALK_MPS_PER_SQRT_S**2 * dt**3 / 3 + (sigma_a_mps2 * dt**2 / 2) ** 2
    return own_m2 <= lost_m2 or dt * 1e9 >= ENOUGH_NS
