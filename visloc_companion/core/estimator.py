"""Delayed-state position filter: a sorted log of inputs folded by core/fusion.py, so that order of arrival does not matter.

A late fix is inserted where it belongs and everything after it is done again (rewind). Between velocity samples the velocity
is interpolated linearly, after the last it is held. The memory is HISTORY_S; what is older than that is TooOld.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from visloc_companion.core import airspeed, fusion, integrity, separation
from visloc_companion.core.airspeed import Airspeed
from visloc_companion.core.fusion import UNAIDED_GAP_S, UNAIDED_SIGMA_MPS, Belief, Position
from visloc_companion.core.motion import Motion, learned
from visloc_companion.core.propagation import POSITION, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Cov2, Fix, GeoPoint, NavState, Rejected, TooOld, Vec2, Vec3

HISTORY_S = 6.0
MAX_CLIMB_HELD_S = 1.0
"""A vertical velocity is held no longer than this beyond its sample."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """The driving velocity and the autopilot's height at a time; `sigma_mps`: how far an autopilot's velocity is believed.

    `sigma_a_mps2`: 1-sigma of the slow error of the accelerations that an inertial one is integrated from.
    """

    t_ns: int
    v_ned_mps: Vec3
    h_amsl_m: float
    sigma_mps: float
    drive: Drive
    sigma_a_mps2: float = 0.0


Around = tuple[Velocity, Velocity | None]
Input = Velocity | Position | Motion | Airspeed
Outcome = Accepted | Rejected | None


class PositionFilter:
    """Position in NED at an origin. `observe` and `at` are protocols.Estimator; `drive` feeds it the autopilot's velocity.

    States that it gives include the map's registration error (`map_sigma_m`), which no number of fixes averages away.
    """

    def __init__(self, settings: NavigatorSettings, origin: GeoPoint, start: Belief, velocity: Velocity) -> None:
        self._settings = settings
        self._origin = origin
        self._base, self._base_velocity = start, velocity
        self._log: list[Input] = []
        self._beliefs: list[Belief] = []
        self._asked: tuple[int, int, Belief] | None = None

    @property
    def newest(self) -> Belief:
        """The belief after the last input."""
        return self._beliefs[-1] if self._beliefs else self._base

    def observe(self, fix: Fix) -> Accepted | Rejected | TooOld:
        """Take a fix at its image time."""
        north, east, _ = wgs84.ned_from_geo(fix.place, self._origin)
        measured = Position(
            fix.t_ns,
            (north, east),
            fix.cov_ne_m2,
            from_fix=True,
            method=fix.method,
            probability_wrong=fix.probability_wrong,
            h_amsl_m=fix.place.h_amsl_m,
            sigma_h_m=fix.sigma_h_m,
            tie=fix.frame_id,
        )
        return self._take(measured)

    def observe_gnss(self, t_ns: int, place: GeoPoint, sigma_m: float) -> Accepted | Rejected | TooOld:
        """Take a trusted GNSS position."""
        north, east, _ = wgs84.ned_from_geo(place, self._origin)
        cov: Cov2 = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
        return self._take(Position(t_ns, (north, east), cov, from_fix=False))

    def observe_motion(self, motion: Motion) -> Accepted | Rejected | TooOld:
        """Take what odometry says of an interval; TooOld where its start is beyond the memory."""
        if motion.t_from_ns < self._base.t_ns:
            return TooOld((self.newest.t_ns - motion.t_from_ns) * 1e-9)
        outcome = self._insert(motion)
        return outcome if outcome is not None else TooOld(0.0)

    def observe_airspeed(self, z: Airspeed) -> None:
        """Take a velocity through the air; one that is older than the memory is dropped."""
        if z.t_ns >= self._base.t_ns:
            self._insert(z)

    def drive(self, velocity: Velocity) -> None:
        """Take a velocity sample; one that is older than the memory is dropped."""
        if velocity.t_ns > self._base.t_ns:
            self._insert(velocity)

    def at(self, t_ns: int) -> NavState:
        """The state at a time: between inputs, or propagated beyond the last."""
        k, belief = self._belief_at(t_ns)
        north, east = (float(v) for v in belief.x[POSITION])
        b_north, b_east = (float(v) for v in belief.x[VELOCITY])
        around = self._around(k)
        v_north, v_east = _velocity_at(t_ns, around)
        extra = self._settings.map_sigma_m**2
        nn, ne, ee = float(belief.P[0, 0]), float(belief.P[0, 1]), float(belief.P[1, 1])
        return NavState(
            t_ns,
            (north, east, self._origin.h_amsl_m - _height_at(t_ns, around)),
            (v_north - b_north, v_east - b_east, around[0].v_ned_mps[2]),
            ((nn + extra, ne), (ne, ee + extra)),
            float(np.sqrt(belief.height_var_m2)),
            max(0.0, (t_ns - belief.rested_ns) * 1e-9),
        )

    def protection_level_m(self, t_ns: int) -> float:
        """Horizontal protection level at a time (core/integrity.py)."""
        _, belief = self._belief_at(t_ns)
        level_m = integrity.protection_level_m(belief.x, belief.P, belief.without, self._settings)
        return integrity.aged(level_m, (t_ns - belief.rested_ns) * 1e-9)

    def know_map(self, sigma_m: float) -> None:
        """Take another 1-sigma of the map's registration, on each axis: it widens what is stated, and the gate."""
        if sigma_m != self._settings.map_sigma_m:
            self._settings = replace(self._settings, map_sigma_m=sigma_m)

    def move_origin(self, origin: GeoPoint) -> None:
        """Express everything about another origin; the vehicle stays where it is."""
        north, east = (float(v) for v in self.newest.x[:2])
        place = wgs84.geo_from_ned((north, east, 0.0), self._origin)
        moved_north, moved_east, _ = wgs84.ned_from_geo(place, origin)
        shift = (moved_north - north, moved_east - east)
        self._origin, self._asked = origin, None
        self._base = _shifted(self._base, shift)
        self._beliefs = [_shifted(belief, shift) for belief in self._beliefs]
        self._log = [
            replace(entry, p_ne_m=(entry.p_ne_m[0] + shift[0], entry.p_ne_m[1] + shift[1]))
            if isinstance(entry, Position)
            else entry
            for entry in self._log
        ]

    def _take(self, z: Position) -> Accepted | Rejected | TooOld:
        if z.t_ns < self._base.t_ns:
            return TooOld((self.newest.t_ns - z.t_ns) * 1e-9)
        outcome = self._insert(z)
        return outcome if outcome is not None else TooOld(0.0)

    def _insert(self, entry: Input) -> Outcome:
        index = bisect_right(self._log, _key(entry), key=_key)
        self._log.insert(index, entry)
        self._asked = None
        start = index
        while start > 0 and not isinstance(self._log[start - 1], Velocity):
            start -= 1
        del self._beliefs[start:]
        wanted: Outcome = None
        for k in range(start, len(self._log)):
            belief, outcome = self._folded(k)
            self._beliefs.append(belief)
            self._asked = None
            wanted = outcome if k == index else wanted
        self._forget()
        return wanted

    def _folded(self, k: int) -> tuple[Belief, Outcome]:
        entry = self._log[k]
        belief = self._carried(self.newest, entry.t_ns, k)
        if isinstance(entry, Velocity):
            if entry.drive is Drive.INERTIAL:
                return fusion.with_inertial_velocity(belief, entry.sigma_a_mps2), None
            return fusion.with_velocity_trust(belief, entry.sigma_mps, entry.drive), None
        if isinstance(entry, Motion):
            return learned(belief, entry, self._travelled(belief, entry.t_from_ns), self._settings)
        if isinstance(entry, Airspeed):
            return airspeed.observed(belief, entry, _velocity_at(entry.t_ns, self._around(k)), self._settings)
        return fusion.observed(belief, entry, _height_at(entry.t_ns, self._around(k)), self._settings)

    def _travelled(self, belief: Belief, t_from_ns: int) -> Vec2:
        """How far the velocity input went since a time, north and east metres."""
        _, start = self._belief_at(t_from_ns)
        return belief.travel_ne_m[0] - start.travel_ne_m[0], belief.travel_ne_m[1] - start.travel_ne_m[1]

    def _belief_at(self, t_ns: int) -> tuple[int, Belief]:
        """How many inputs are no later than a time (of those that are folded), and the belief carried to it.

        The last answer is kept: within one event of the navigator the same time is asked about again and again.
        """
        asked = self._asked
        if asked is not None and asked[0] == t_ns:
            return asked[1:]
        k = bisect_right(self._log, t_ns, key=_time, hi=len(self._beliefs))
        belief = self._carried(self._beliefs[k - 1] if k else self._base, t_ns, k)
        self._asked = (t_ns, k, belief)
        return k, belief

    def _carried(self, belief: Belief, t_ns: int, k: int) -> Belief:
        around = self._around(k)
        start, end = _velocity_at(belief.t_ns, around), _velocity_at(t_ns, around)
        mean = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        change = (end[0] - start[0], end[1] - start[1])
        carried = fusion.propagated(belief, t_ns, mean, self._settings, change)
        before, after = around
        gap_s = ((t_ns if after is None else after.t_ns) - before.t_ns) * 1e-9
        return fusion.blurred(carried, UNAIDED_SIGMA_MPS * (t_ns - belief.t_ns) * 1e-9) if gap_s > UNAIDED_GAP_S else carried

    def _around(self, k: int) -> Around:
        """The velocity samples before and after the first k inputs."""
        log = self._log
        before = next((log[i] for i in range(k - 1, -1, -1) if isinstance(log[i], Velocity)), self._base_velocity)
        after = next((log[i] for i in range(k, len(log)) if isinstance(log[i], Velocity)), None)
        return cast("Around", (before, after))

    def _forget(self) -> None:
        """Drop what is older than the memory; a motion that reaches further back keeps its start."""
        horizon_ns = self._log[-1].t_ns - round(HISTORY_S * 1e9)
        starts = (e.t_from_ns for e in self._log if isinstance(e, Motion) and e.t_from_ns < horizon_ns < e.t_ns)
        horizon_ns = min(starts, default=horizon_ns)
        n_old = bisect_right(self._log, horizon_ns, key=_time)
        if n_old:
            self._base, self._base_velocity = self._beliefs[n_old - 1], self._around(n_old)[0]
            del self._log[:n_old], self._beliefs[:n_old]
            self._asked = None


def _share(t_ns: int, around: Around) -> tuple[Velocity, Velocity, float]:
    before, after = around
    another = before.drive is Drive.INERTIAL and after is not None and after.drive is not Drive.INERTIAL
    if after is None or another or after.t_ns <= before.t_ns:
        return before, before, 0.0
    return before, after, (t_ns - before.t_ns) / (after.t_ns - before.t_ns)


def _velocity_at(t_ns: int, around: Around) -> Vec2:
    before, after, share = _share(t_ns, around)
    (n0, e0, _), (n1, e1, _) = before.v_ned_mps, after.v_ned_mps
    return n0 + share * (n1 - n0), e0 + share * (e1 - e0)


def _height_at(t_ns: int, around: Around) -> float:
    before, after, share = _share(t_ns, around)
    if after is not before:
        return before.h_amsl_m + share * (after.h_amsl_m - before.h_amsl_m)
    held_s = min(MAX_CLIMB_HELD_S, max(0.0, (t_ns - before.t_ns) * 1e-9))
    return before.h_amsl_m - before.v_ned_mps[2] * held_s


def _time(entry: Input) -> int:
    return entry.t_ns


def _key(entry: Input) -> tuple[int, int, int]:
    if isinstance(entry, Velocity | Airspeed):
        return entry.t_ns, 0 if isinstance(entry, Velocity) else 1, 0
    return (entry.t_ns, 2, entry.t_from_ns) if isinstance(entry, Motion) else (entry.t_ns, 3, entry.tie)


def _shifted(belief: Belief, shift: Vec2) -> Belief:
    def moved(p: Vec2) -> Vec2:
        return p[0] + shift[0], p[1] + shift[1]

    rejected = tuple(replace(c, anchor_ne_m=moved(c.anchor_ne_m)) for c in belief.rejected)
    without = separation.shifted(belief.without, np.array(shift))
    x = belief.x.copy()
    x[POSITION] += shift
    return replace(belief, x=x, rejected=rejected, without=without)
