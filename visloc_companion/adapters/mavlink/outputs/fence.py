"""The last line of defence in front of the outbox: what a position may be, beside sound (soundness.py), to be sent.

Nothing outside the map and its margin, nothing that is not of now, nothing about another origin than the autopilot's, and no step
that the autopilot is not told of: where the injection does not announce one its reset counter is moved on here. A message
without such a counter claims the step as its own uncertainty, which is taken back at `CATCH_UP_MPS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from visloc_companion.adapters.mavlink.outputs.covariance import MAX_SIGMA_M
from visloc_companion.adapters.mavlink.outputs.kinds import Output
from visloc_companion.adapters.mavlink.outputs.soundness import fault
from visloc_companion.core.step import step_m
from visloc_companion.errors import Reason
from visloc_companion.geo import wgs84
from visloc_companion.types import AutopilotKind, GeoPoint, Injection

MAX_AGE_NS, MAX_LEAD_NS = 200_000_000, 50_000_000
"""PX4 drops what is older than EKF2_DELAY_MAX (200 ms), ArduPilot takes it for younger than it is."""
SAME_PLACE_M = 1.0
CATCH_UP_MPS = 2.0
_M_PER_DEG = 111_000.0


@dataclass(frozen=True, slots=True)
class Fence:
    """Latitudes and longitudes (degrees) between which positions may be sent, and by how much these are exceeded (m)."""

    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float
    margin_m: float

    def contains(self, place: GeoPoint) -> bool:
        """Whether a place may be sent; east of the date line as well as west of it."""
        margin_lat = self.margin_m / _M_PER_DEG
        if not self.south_deg - margin_lat <= place.lat_deg <= self.north_deg + margin_lat:
            return False
        margin_lon = margin_lat / max(0.01, math.cos(math.radians(place.lat_deg)))
        width = (self.east_deg - self.west_deg) % 360
        return (place.lon_deg - self.west_deg + margin_lon) % 360 <= width + 2 * margin_lon


class Gate:
    """Stateful: knows what was let through last, and takes for granted that it was sent."""

    def __init__(self, fence: Fence | None, max_step_m: float) -> None:
        self._fence, self._max_step_m = fence, max_step_m
        self._last: Injection | None = None
        self._origin: GeoPoint | None = None
        self._own_counts = 0
        self._owed_m = 0.0

    def judge(
        self, injection: Injection, output: Output, kind: AutopilotKind, origin: GeoPoint | None, now_ns: int
    ) -> Injection | Reason:
        """The injection as it is to be sent now, or why it must not be."""
        reason = fault(injection) or self._objection(injection, output, now_ns)
        if reason is not None:
            return reason
        if origin is None:
            return Reason.NO_ORIGIN
        if not _about(injection, kind, origin):
            return Reason.BAD_INPUT
        self._know_origin(kind, origin, output)
        return self._announced(injection, output)

    def _objection(self, injection: Injection, output: Output, now_ns: int) -> Reason | None:
        backwards = self._last is not None and injection.t_ns < self._last.t_ns
        if backwards or injection.t_ns > now_ns + MAX_LEAD_NS:
            return Reason.IMPLAUSIBLE_TIME
        if injection.t_ns < now_ns - MAX_AGE_NS:
            return Reason.TOO_OLD
        if output.needs_velocity and (injection.v_ned_mps is None or injection.cov_v_ne_m2ps2 is None):
            return Reason.NOT_SEEDED
        inside = self._fence is None or self._fence.contains(injection.place)
        return None if inside else Reason.OUTSIDE_MAP

    def _know_origin(self, kind: AutopilotKind, origin: GeoPoint, output: Output) -> None:
        """To a message of latitude and longitude, which are those without a counter, another origin is no step."""
        last, moved, self._origin = self._last, origin != self._origin, origin
        if moved and last is not None and not output.announces_steps:
            self._last = replace(last, p_ned_m=wgs84.autopilot_ned_from_geo(kind, last.place, origin))

    def _announced(self, injection: Injection, output: Output) -> Injection:
        """With a counter, or a covariance, that fits the step since the last one."""
        last, self._last = self._last, injection
        if last is not None:
            step_m, elapsed_s = _step_m(last, injection), (injection.t_ns - last.t_ns) * 1e-9
            self._owed_m = max(0.0, self._owed_m - CATCH_UP_MPS * elapsed_s)
            if step_m > self._max_step_m:
                self._owed_m = max(self._owed_m, step_m)
                self._own_counts += injection.reset_counter % 256 == last.reset_counter % 256
        counted = replace(injection, reset_counter=(injection.reset_counter + self._own_counts) % 256)
        return counted if output.announces_steps or self._owed_m == 0.0 else widened(counted, self._owed_m)


def widened(injection: Injection, sigma_m: float) -> Injection:
    """The injection with an independent error added to its horizontal position, within what may be sent."""
    (nn, ne), (en, ee) = injection.cov_ne_m2
    more = min(sigma_m**2, MAX_SIGMA_M**2 - max(nn, ee))
    return replace(injection, cov_ne_m2=((nn + more, ne), (en, ee + more)))


def _step_m(last: Injection, now: Injection) -> float:
    """How far a position is from where the last one's motion leads; a velocity that is unknown is none."""
    before, after = last.v_ned_mps or (0.0, 0.0, 0.0), now.v_ned_mps or last.v_ned_mps or (0.0, 0.0, 0.0)
    return step_m(last.p_ned_m, before, now.p_ned_m, after, (now.t_ns - last.t_ns) * 1e-9)


def _about(injection: Injection, kind: AutopilotKind, origin: GeoPoint) -> bool:
    """Whether local and global coordinates of an injection are one place, seen from the autopilot's origin."""
    local = wgs84.autopilot_ned_from_geo(kind, injection.place, origin)
    return math.dist(local, injection.p_ned_m) <= SAME_PLACE_M
