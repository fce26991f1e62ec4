"""Delayed-state position filter: a sorted log of inputs folded by filter/fusion.py, so that order of arrival does not matter.

A late fix is inserted where it belongs and everything after it is done again (rewind), but not before it is asked for: two that
come together are folded once. The velocity between its samples: driving.py. The memory is HISTORY_NS; what is older is TooOld.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple, cast

from visloc_companion.core import integrity
from visloc_companion.core.filter import by_gnss, contradiction, fusion, lasting, refused, revised, votes
from visloc_companion.core.filter.belief import Belief, Position, blurred, lens_doubted, lens_known
from visloc_companion.core.filter.driving import Around, Velocity, height_at, mean_and_change, velocity_at
from visloc_companion.core.filter.motion import Motion, learned
from visloc_companion.core.filter.propagation import OVERDUE_S, POSITION, UNAIDED_GAP_S, VELOCITY, Drive
from visloc_companion.core.filter.reckoned import Reckoned, reckoned
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.velocity import air_velocity
from visloc_companion.geo import wgs84
from visloc_companion.geo.se3 import euler_from_quat
from visloc_companion.types import Accepted, Cov2, Fix, GeoPoint, NavState, Rejected, TooOld, Vec2

HISTORY_NS = 6_000_000_000

Input = Velocity | Position | Motion | air_velocity.AirError | by_gnss.BesideGnss
Outcome = Accepted | Rejected | None
_time = attrgetter("t_ns")


class PositionFilter:
    """Position in NED at an origin. `observe` and `at` are protocols.Estimator; `drive` feeds it the autopilot's velocity.

    States that it gives include the map's registration error (`map_sigma_m`), which no number of fixes averages away; of the
    height, which is the autopilot's, they know nothing (height.py). `max_step_m`: larger corrections are sent as resets.
    """

    def __init__(
        self,
        settings: NavigatorSettings,
        origin: GeoPoint,
        start: Belief,
        velocity: Velocity,
        max_step_m: float = fusion.MAX_STEP_M,
    ) -> None:
        self._settings, self._max_step_m = settings, max_step_m
        self._origin = origin
        self._base, self._base_velocity = start, velocity
        self._log: list[Input] = []
        self._motions: list[Motion] = []
        self._beliefs: list[Belief] = []
        self._asked: _Asked | None = None

    @property
    def newest(self) -> Belief:
        """The belief after the last input."""
        return self._after(len(self._log))

    @property
    def rests(self) -> Belief:
        """A belief that rests on the same start and fixes as the newest: velocities after the last measurement change nothing of
        that (nor does a GNSS beside it), and need not be folded for it only to be folded again after a late fix."""
        n = len(self._log)
        while n > len(self._beliefs) and isinstance(self._log[n - 1], Velocity | by_gnss.BesideGnss):
            n -= 1
        return self._after(n)

    @property
    def earliest_ns(self) -> int:
        """What was seen before this time can no longer be taken, or not yet: the filter began later."""
        return self._base.t_ns

    def observe(self, fix: Fix, mounting_rad: float = 0.0) -> Accepted | Rejected | TooOld:
        """Take a fix at its image time. `mounting_rad`: 1-sigma on each axis of the mounting in its claim."""
        north, east, _ = wgs84.ned_from_geo(fix.place, self._origin)
        height_m = fix.place.h_amsl_m - self._origin.h_amsl_m
        view_ne_m, spacing_m = votes.looked_at(fix, height_m)
        measured = Position(
            fix.t_ns,
            (north, east),
            fix.cov_ne_m2,
            from_fix=True,
            method=fix.method,
            probability_wrong=fix.probability_wrong,
            tie=fix.frame_id,
            apart_m=lasting.apart_m(height_m),
            per_focal_ne_m=fix.per_focal_ne_m,
            view_ne_m=view_ne_m,
            spacing_m=spacing_m,
            heading_rad=euler_from_quat(fix.q_ned_frd)[2],
            mounting_rad=mounting_rad,
            height_m=height_m,
        )
        return self._take(measured)

    def observe_gnss(self, t_ns: int, place: GeoPoint, sigma_m: float) -> Accepted | Rejected | TooOld:
        """Take a trusted GNSS position."""
        north, east, _ = wgs84.ned_from_geo(place, self._origin)
        cov: Cov2 = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
        return self._take(Position(t_ns, (north, east), cov, from_fix=False))

    def beside_gnss(self, t_ns: int, place: GeoPoint, sigma_m: float) -> None:
        """Where a trusted GNSS has the vehicle: for the level alone (by_gnss.py). What is older than the memory, or no news, is
        dropped."""
        if t_ns < self._base.t_ns or not by_gnss.tells(self.rests, sigma_m**2):
            return
        north, east, _ = wgs84.ned_from_geo(place, self._origin)
        self._insert(by_gnss.BesideGnss(t_ns, (north, east), sigma_m**2))
        self._forget()

    def observe_motion(self, motion: Motion) -> Accepted | Rejected | TooOld:
        """Take what odometry says of an interval; TooOld where its start is beyond the memory."""
        if motion.t_from_ns < self._base.t_ns:
            return TooOld((self.newest.t_ns - motion.t_from_ns) * 1e-9)
        return self._measured(motion)

    def observe_air(self, z: air_velocity.AirError) -> None:
        """Take what the air tells of the driving velocity; what is older than the memory is dropped."""
        if z.t_ns >= self._base.t_ns:
            self._insert(z)
            self._forget()

    def drive(self, velocity: Velocity) -> None:
        """Take a velocity sample; one that is older than the memory is dropped."""
        if velocity.t_ns > self._base.t_ns:
            self._insert(velocity)
            self._forget()

    def at(self, t_ns: int) -> NavState:
        """The state at a time: between inputs, or propagated beyond the last."""
        around, belief = self._belief_at(t_ns, alone=True)
        x = belief.x.tolist()
        (north, east), (b_north, b_east) = x[POSITION], x[VELOCITY]
        v_north, v_east = velocity_at(t_ns, around)
        extra = self._settings.map_sigma_m**2
        (nn, ne), (_, ee) = belief.P[POSITION, POSITION].tolist()
        (vnn, vne), (_, vee) = belief.P[VELOCITY, VELOCITY].tolist()
        return NavState(
            t_ns,
            (north, east, self._origin.h_amsl_m - height_at(t_ns, around)),
            (v_north - b_north, v_east - b_east, around[0].v_ned_mps[2]),
            ((nn + extra, ne), (ne, ee + extra)),
            math.inf,
            max(0.0, (t_ns - belief.rested_ns) * 1e-9),
            ((vnn, vne), (vne, vee)),
        )

    def protection_level_m(self, t_ns: int, gnss_false: float = 1.0) -> float:
        """Horizontal protection level at a time (core/integrity.py), where what GNSS told is false with this probability."""
        _, belief = self._belief_at(t_ns, alone=False)
        others = contradiction.beside(belief, self._settings)
        level_m = integrity.protection_level_m(belief.x, belief.P, others, belief.alike, self._settings, gnss_false)
        return integrity.aged(level_m, (t_ns - belief.rested_ns) * 1e-9)

    def reckoned(self, t_ns: int) -> Reckoned:
        """What the driving velocity has come to at a time, and what is known of its error."""
        return reckoned(self._belief_at(t_ns, alone=True)[1])

    def stood(self, t_ns: int, stood_ns: int) -> None:
        """The clock showed no more than t_ns for so long: the vehicle went on by that, at a velocity known no better than where
        none arrives. What bears an earlier time is TooOld from now on, for two moments bear it."""
        (before, _), belief = self._belief_at(t_ns, alone=False)
        gone = self._carried(belief, t_ns + stood_ns, (before, None))
        self._begin_anew(t_ns, revised.stood(gone, stood_ns * 1e-9), before)

    def leapt(self, t_ns: int, leapt_ns: int, since_ns: int) -> None:
        """The clock counted so much, from since_ns on, that did not go by: the vehicle is as much further back, at a velocity
        known no better than where none arrives. A fix of after the leap has said so already."""
        (before, _), belief = self._belief_at(t_ns, alone=False)
        if belief.last_fix_ns is not None and belief.last_fix_ns > since_ns:
            return
        v_north, v_east, _ = self.at(t_ns).v_ned_mps
        self._begin_anew(t_ns, revised.leapt(belief, (v_north, v_east), leapt_ns * 1e-9), before)

    def dragged(self, t_ns: int, sigma_m: float) -> None:
        """The position may have been dragged away by so much (1-sigma) in a way that nothing contradicted."""
        (before, _), belief = self._belief_at(t_ns, alone=False)
        self._begin_anew(t_ns, refused.dragged(belief, sigma_m), before)

    def doubt_lens(self, share: float, per_focal_ne_m: Vec2) -> None:
        """The lens is off by about a share (belief.lens_doubted); the last fix had so much of it, metres per share."""
        belief = self.newest
        before, _ = self._around(len(self._log))
        self._begin_anew(belief.t_ns, lens_doubted(belief, share, per_focal_ne_m), before)

    def know_lens(self, share: float) -> None:
        """Frames are looked at through another lens, which may be off by a share (belief.lens_known)."""
        belief = self.newest
        before, _ = self._around(len(self._log))
        self._begin_anew(belief.t_ns, lens_known(belief, share), before)

    def retimed(self, later_s: float) -> None:
        """Frames turned out to be taken so much later than their fixes said: the position may be off by the way of that time."""
        belief = self.newest
        before, _ = self._around(len(self._log))
        self._begin_anew(belief.t_ns, revised.retimed(belief, before.v_ned_mps[:2], later_s), before)

    def doubt_motion(self, autopilots_ne_mps: Vec2) -> None:
        """What odometry has taught since the last fix was wrong: position and velocity may be off by what it makes the velocity
        another than the autopilot's."""
        belief = self.newest
        before, _ = self._around(len(self._log))
        v_north, v_east, _ = self.at(belief.t_ns).v_ned_mps
        self._begin_anew(belief.t_ns, revised.motion_doubted(belief, (v_north, v_east), autopilots_ne_mps), before)

    def _begin_anew(self, t_ns: int, belief: Belief, velocity: Velocity) -> None:
        self._base = belief._replace(t_ns=t_ns)
        self._base_velocity = replace(velocity, t_ns=min(velocity.t_ns, t_ns))
        self._log, self._motions, self._beliefs, self._asked = [], [], [], None

    def know_map(self, sigma_m: float) -> None:
        """Take another 1-sigma of the map's registration, on each axis: it widens what is stated, and the gate."""
        self._settings = replace(self._settings, map_sigma_m=sigma_m)

    def move_origin(self, origin: GeoPoint) -> None:
        """Express everything about another origin; the vehicle stays where it is."""
        north, east = self.newest.x[:2].tolist()
        place = wgs84.geo_from_ned((north, east, 0.0), self._origin)
        moved_north, moved_east, _ = wgs84.ned_from_geo(place, origin)
        shift = (moved_north - north, moved_east - east)
        self._origin, self._asked = origin, None
        self._base = revised.shifted(self._base, shift)
        self._beliefs = [revised.shifted(belief, shift) for belief in self._beliefs]
        self._log = [
            replace(entry, p_ne_m=(entry.p_ne_m[0] + shift[0], entry.p_ne_m[1] + shift[1]))
            if isinstance(entry, Position | by_gnss.BesideGnss)
            else entry
            for entry in self._log
        ]

    def _take(self, z: Position) -> Accepted | Rejected | TooOld:
        if z.t_ns < self.earliest_ns:
            return TooOld((self.newest.t_ns - z.t_ns) * 1e-9)
        return self._measured(z)

    def _measured(self, z: Position | Motion) -> Accepted | Rejected | TooOld:
        index = self._insert(z)
        belief, outcome = self._folded(index)
        self._beliefs.append(belief)
        self._forget()
        return outcome if outcome is not None else TooOld(0.0)

    def _insert(self, entry: Input) -> int:
        """Into the log. What was folded from there on is forgotten; of a velocity also what it interpolates anew."""
        log, key = self._log, _key(entry)
        index = len(log) if not log or key >= _key(log[-1]) else bisect_right(log, key, key=_key)
        log.insert(index, entry)
        if isinstance(entry, Motion):
            self._motions.append(entry)
        start = index
        while isinstance(entry, Velocity) and start > 0 and not isinstance(self._log[start - 1], Velocity):
            start -= 1
        del self._beliefs[start:]
        self._asked = None
        return index

    def _after(self, n: int) -> Belief:
        """The belief after the first n inputs."""
        for k in range(len(self._beliefs), n):
            self._beliefs.append(self._folded(k)[0])
        return self._beliefs[n - 1] if n else self._base

    def _folded(self, k: int) -> tuple[Belief, Outcome]:
        entry, around = self._log[k], self._around(k)
        belief = self._predicted(self._after(k), entry.t_ns, around)
        if isinstance(entry, Velocity):
            if entry.drive is Drive.INERTIAL:
                return fusion.with_inertial_velocity(belief, entry.sigma_a_mps2, entry.more_heading_rad2), None
            return fusion.with_velocity_trust(belief, entry.sigma_mps, entry.drive), None
        if isinstance(entry, Motion):
            return learned(belief, entry, self._travelled(belief, entry.t_from_ns), self._settings)
        if isinstance(entry, by_gnss.BesideGnss):
            return by_gnss.held(belief, entry, fusion.CONSIDERED[belief.drive]), None
        if isinstance(entry, air_velocity.AirError):
            return air_velocity.observed(belief, entry, self._settings)
        return fusion.observed(belief, entry, self._settings, self._max_step_m)

    def _travelled(self, belief: Belief, t_from_ns: int) -> Vec2:
        """How far the velocity input went since a time, north and east metres."""
        k = bisect_right(self._log, t_from_ns, key=_time, hi=len(self._beliefs))
        start = self._after(k)
        (north, east), _ = mean_and_change(start.t_ns, t_from_ns, self._around(k))
        dt = max(0.0, (t_from_ns - start.t_ns) * 1e-9)
        north, east = start.travel_ne_m[0] + north * dt, start.travel_ne_m[1] + east * dt
        return belief.travel_ne_m[0] - north, belief.travel_ne_m[1] - east

    def _belief_at(self, t_ns: int, *, alone: bool) -> tuple[Around, Belief]:
        """The velocities around a time, and the belief carried to it; `alone`: its other solutions are not needed.

        The last answer is kept: within one event of the navigator the same time is asked about again and again.
        """
        asked = self._asked
        if asked is not None and asked.t_ns == t_ns and (alone or not asked.alone):
            return asked.around, asked.belief
        log = self._log
        k = len(log) if not log or t_ns >= log[-1].t_ns else bisect_right(log, t_ns, key=_time)
        alone = alone and k < len(log)  # of the present state the protection level is asked, too
        around = self._around(k)
        belief = self._predicted(self._after(k), t_ns, around, alone=alone)
        self._asked = _Asked(t_ns, around, belief, alone)
        return around, belief

    def _predicted(self, belief: Belief, t_ns: int, around: Around, *, alone: bool = False) -> Belief:
        """The belief carried to a time, with what a velocity that is overdue claims."""
        carried, (before, after) = self._carried(belief, t_ns, around, alone=alone), around
        if after is not None:
            return carried
        from_s, to_s = (belief.t_ns - before.t_ns) * 1e-9, (t_ns - before.t_ns) * 1e-9
        overdue = from_s < to_s and OVERDUE_S < to_s <= UNAIDED_GAP_S
        return blurred(carried, _held_m(from_s, to_s)) if overdue else carried

    def _carried(self, belief: Belief, t_ns: int, around: Around, *, alone: bool = False) -> Belief:
        if t_ns == belief.t_ns:
            return belief
        before, after = around
        gap_s = ((t_ns if after is None else after.t_ns) - before.t_ns) * 1e-9
        if after is not None and gap_s > UNAIDED_GAP_S and after.drive is not before.drive:
            erring = fusion.propagated(belief, after.t_ns, (0.0, 0.0), self._settings, alone=True)
            around = before, _as_if_it_erred(after, erring)
        mean, change = mean_and_change(belief.t_ns, t_ns, around)
        carried = fusion.propagated(belief, t_ns, mean, self._settings, change, alone=alone)
        return blurred(carried, fusion.UNAIDED_SIGMA_MPS * (t_ns - belief.t_ns) * 1e-9) if gap_s > UNAIDED_GAP_S else carried

    def _around(self, k: int) -> Around:
        """The velocity samples before and after the first k inputs."""
        log, before, after = self._log, k - 1, k
        while before >= 0 and not isinstance(log[before], Velocity):
            before -= 1
        while after < len(log) and not isinstance(log[after], Velocity):
            after += 1
        sample = log[before] if before >= 0 else self._base_velocity
        return cast("Around", (sample, log[after] if after < len(log) else None))

    def _forget(self) -> None:
        """Drop what is older than the memory; a motion that reaches further back keeps its start."""
        horizon_ns, oldest_ns, motions = self._log[-1].t_ns - HISTORY_NS, self._log[0].t_ns, self._motions
        held = bool(motions) and motions[0].t_ns > horizon_ns and motions[0].t_from_ns < oldest_ns  # as it mostly is
        if held or oldest_ns > horizon_ns:
            return
        self._motions = [motion for motion in motions if motion.t_ns > horizon_ns]
        horizon_ns = min([horizon_ns, *(motion.t_from_ns for motion in self._motions)])
        if oldest_ns > horizon_ns:
            return
        n_old = bisect_right(self._log, horizon_ns, key=_time)
        self._base, self._base_velocity = self._after(n_old), self._around(n_old)[0]
        del self._log[:n_old], self._beliefs[:n_old]
        self._asked = None


class _Asked(NamedTuple):
    """A belief carried to a time, between these velocities; `alone`: without its other solutions."""

    t_ns: int
    around: Around
    belief: Belief
    alone: bool


def _as_if_it_erred(after: Velocity, belief: Belief) -> Velocity:
    """The velocity at the end of a gap with the error that the one before is known to have by then (`belief`), which is taken off
    until that end."""
    (b_north, b_east), (v_north, v_east, v_down) = belief.x[VELOCITY].tolist(), after.v_ned_mps
    return replace(after, v_ned_mps=(v_north + b_north, v_east + b_east, v_down))


def _held_m(from_s: float, to_s: float) -> float:
    """1-sigma of where a vehicle is taken to by a velocity that is held between these ages of its sample, m: it is less known by
    the second, until at UNAIDED_GAP_S as much is claimed as of a silent link."""
    return fusion.UNAIDED_SIGMA_MPS * (to_s**2 - max(0.0, from_s) ** 2) / UNAIDED_GAP_S


def _key(entry: Input) -> tuple[int, int, int]:
    if isinstance(entry, Velocity | air_velocity.AirError):
        return entry.t_ns, 0 if isinstance(entry, Velocity) else 1, 0
    if isinstance(entry, Motion):
        return entry.t_ns, 2, entry.t_from_ns
    return (entry.t_ns, 3, entry.tie) if isinstance(entry, Position) else (entry.t_ns, 4, 0)
