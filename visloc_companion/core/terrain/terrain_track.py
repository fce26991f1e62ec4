"""Dead reckoning for soundings: where the vehicle was against where it is, by the autopilot's velocity alone.

Fixes never correct it: a correction amid a profile of the ground would bend the profile. It begins anew where the velocity had a
hole, or became another velocity with another error. What the autopilot's height jumps by is taken out: amid a profile a jump of
5 m would be a step of the ground, which fits tens of metres aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.core.filter.driving import Velocity, jumped_m
from visloc_companion.types import Vec2

MAX_GAP_NS = 1_000_000_000
"""Velocities further apart end the track: how far the vehicle came meanwhile is not known."""


@dataclass(frozen=True, slots=True)
class Node:
    """Dead reckoning at a time: metres north and east of where it began, of track flown, and the height above sea level by the
    autopilot's reckoning when it began."""

    t_ns: int
    north_m: float
    east_m: float
    flown_m: float
    h_amsl_m: float

    def carried(self, dt_ns: int, v_ne_mps: Vec2, h_amsl_m: float) -> Node:
        """After (before, where `dt_ns` is negative) some time at a velocity."""
        dt_s = dt_ns * 1e-9
        north, east = v_ne_mps[0] * dt_s, v_ne_mps[1] * dt_s
        flown = self.flown_m + math.copysign(math.hypot(north, east), dt_s)
        return Node(self.t_ns + dt_ns, self.north_m + north, self.east_m + east, flown, h_amsl_m)


class Track:
    """The newest node and the velocity there."""

    def __init__(self) -> None:
        self._velocity: Velocity | None = None
        self._now: Node | None = None
        self._jumped_m = 0.0

    def clear(self) -> None:
        """The track is interrupted."""
        self._velocity = self._now = None

    def drive(self, velocity: Velocity) -> bool:
        """Carry on by a velocity sample, with the mean of it and the last; False where the track begins anew with it."""
        last, now, self._velocity = self._velocity, self._now, velocity
        gap_ns = 0 if last is None else velocity.t_ns - last.t_ns
        if last is None or now is None or last.drive is not velocity.drive or not 0 < gap_ns <= MAX_GAP_NS:
            self._now, self._jumped_m = Node(velocity.t_ns, 0.0, 0.0, 0.0, velocity.h_amsl_m), 0.0
            return False
        (n0, e0, d0), (n1, e1, d1) = last.v_ned_mps, velocity.v_ned_mps
        dt_s = gap_ns * 1e-9
        self._jumped_m += jumped_m(velocity.h_amsl_m - last.h_amsl_m + (d0 + d1) / 2 * dt_s, dt_s)
        self._now = now.carried(gap_ns, ((n0 + n1) / 2, (e0 + e1) / 2), velocity.h_amsl_m - self._jumped_m)
        return True

    def at(self, t_ns: int) -> Node | None:
        """The track at a time within MAX_GAP_NS of the last velocity sample, by that velocity."""
        now, velocity = self._now, self._velocity
        if now is None or velocity is None or abs(t_ns - now.t_ns) > MAX_GAP_NS:
            return None
        v_north, v_east, v_down = velocity.v_ned_mps
        since_ns = t_ns - now.t_ns
        return now.carried(since_ns, (v_north, v_east), now.h_amsl_m - v_down * since_ns * 1e-9)


class LearnedVelocity:
    """What fixes of the terrain teach of an autopilot's velocity that descends from positions which it was sent."""

    AFTER_S, MOST_MPS = 10.0, 10.0
    """Learnt from fixes that come so long after the one before; no larger error is learnt."""
    FORGOTTEN_S = 2.0
    """It is taken off for about this time: until the autopilot, to which the corrected position is injected, has corrected its
    own velocity. One that is quicker is corrected wholly, a slower one in part, none too much."""

    def __init__(self) -> None:
        self._learned: tuple[int, Vec2] = (0, (0.0, 0.0))

    def learn(self, t_ns: int, off_ne_m: Vec2, sigma_m: float, since_s: float) -> None:
        """The state was off by so much at a fix of a 1-sigma, after `since_s` without any."""
        squared, noise = off_ne_m[0] ** 2 + off_ne_m[1] ** 2, sigma_m**2
        if since_s >= self.AFTER_S and squared > noise:
            share = min((1 - noise / squared) / since_s, self.MOST_MPS / math.sqrt(squared))
            self._learned = (t_ns, (share * off_ne_m[0], share * off_ne_m[1]))

    def error_at(self, t_ns: int) -> Vec2:
        """What is left of the error, north and east m/s."""
        learned_ns, (north, east) = self._learned
        left = math.exp(-max(0, t_ns - learned_ns) * 1e-9 / self.FORGOTTEN_S)
        return left * north, left * east
