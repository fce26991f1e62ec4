"""Soundings along the track: distances measured downwards become a profile of the ground, and the worker is asked where it fits.

The track is dead reckoning by the autopilot's velocity (core/terrain/terrain_track.py). A stretch of it is asked about when it is
long enough and again each time it has grown; what is refused is kept and joined with what comes, what was accepted is never used
twice. From far off a first answer waits for a second one that agrees with it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.terrain.terrain_track import LearnedVelocity, Node, Track
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, GeoPoint, NavState, NoFix, PosePrior, Quat, Range, Sounding, TerrainRequest, Vec3

METHOD = "terrain"
SPACING_M = 5.0
"""Of each so much of the track the lowest sounding is kept: where crowns have gaps, that is the ground."""
SHORTEST_M, LONGEST_M, GROWTH = 600.0, 8000.0, 1.3
LONGEST_NS = 400_000_000_000
MAX_TILT_RAD = math.radians(25.0)
FAR_SIGMA_M = 150.0
"""A prior with a larger 1-sigma may be fitted by a wrong valley: its first answer waits for a second."""
AGREE_SIGMA = 3.0
FEWEST = 30
"""Fewer soundings are no profile."""
STEADY_MPS2, DRIFTING_MPS2 = 0.005, 0.02
"""1-sigma of the acceleration error of the autopilot's velocity, with GNSS and without (a tilt of 0.03 and 0.1 degrees)."""
WANDER = 0.02
"""Share of the way made by an acceleration error that remains beside the best parabola when the error changes over a minute
(first-order Gauss-Markov, simulated for stretches of 40 to 250 s)."""


@dataclass(frozen=True, slots=True)
class _Sounded:
    """A sounding with the dead reckoning of its time; `beam_neu_m` from the vehicle to the surface."""

    at: Node
    beam_neu_m: tuple[float, float, float]

    @property
    def surface_m(self) -> float:
        return self.at.h_amsl_m + self.beam_neu_m[2]


@dataclass(frozen=True, slots=True)
class _Asked:
    """What was asked: the dead reckoning then, and whether the prior was far off; `ended`: the track has begun anew since."""

    request_id: int
    at: Node
    far: bool
    sigma_v_mps: float
    ended: bool = False


class TerrainAiding:
    """Collects, decides when to ask, and holds back what stands alone. The navigator calls it, in order of time."""

    def __init__(self) -> None:
        self._track, self._learned = Track(), LearnedVelocity()
        self._soundings: deque[_Sounded] = deque()
        self._lowest: _Sounded | None = None
        self._next_m, self._cell = 0.0, 0
        self._asked: _Asked | None = None
        self._waiting: tuple[Fix, _Asked] | None = None

    def clear(self) -> None:
        """Forget the stretch (the track is interrupted)."""
        self._track.clear()
        self._begin()

    def _begin(self) -> None:
        """A stretch without soundings, on a track of its own."""
        self._lowest = self._waiting = None
        self._soundings.clear()
        self._next_m, self._cell = 0.0, 0
        if self._asked is not None:
            self._asked = replace(self._asked, ended=True)

    def learn(self, fix: Fix, state: NavState, origin: GeoPoint) -> None:
        """What a fix that the filter took says of the velocity since the last one; `state` is the filter's without it."""
        north, east, _ = wgs84.ned_from_geo(fix.place, origin)
        off = (state.p_ned_m[0] - north, state.p_ned_m[1] - east)
        self._learned.learn(fix.t_ns, off, largest_sigma_m(fix.cov_ne_m2), state.age_of_fix_s)

    def corrected(self, t_ns: int, v_ned_mps: Vec3) -> Vec3:
        """A velocity of the autopilot that descends from injected positions, less what was learnt of its error."""
        north, east = self._learned.error_at(t_ns)
        return v_ned_mps[0] - north, v_ned_mps[1] - east, v_ned_mps[2]

    def drive(self, velocity: Velocity) -> None:
        """Carry the dead reckoning on by a velocity sample; where it begins anew, so does the stretch."""
        if not self._track.drive(velocity):
            self._begin()

    def on_range(self, event: Range, t_ns: int, q_ned_frd: Quat) -> None:
        """Take a distance along the body's down axis, measured at a time and attitude."""
        node, down = self._track.at(t_ns), se3.rotate(q_ned_frd, (0.0, 0.0, 1.0))
        if node is None or not event.valid or not event.distance_m > 0 or down[2] < math.cos(MAX_TILT_RAD):
            return
        new = _Sounded(node, (event.distance_m * down[0], event.distance_m * down[1], -event.distance_m * down[2]))
        low, cell = self._lowest, math.floor(node.flown_m / SPACING_M)
        if low is None or cell != self._cell:
            if low is not None:
                self._soundings.append(low)
            self._lowest, self._cell = new, cell
        elif new.surface_m < low.surface_m:
            self._lowest = new
        while self._soundings and _too_far(self._soundings[0].at, node):
            self._soundings.popleft()

    def due(self, t_ns: int) -> bool:
        """Whether a question is to be asked of the stretch that ends now."""
        node = self._track.at(t_ns)
        long_enough = node is not None and node.flown_m >= self._next_m and self._length_m(node) >= SHORTEST_M
        return long_enough and self._asked is None and len(self._soundings) >= FEWEST

    def request(self, request_id: int, t_ns: int, prior: PosePrior, sigma_v_mps: float, steady: bool) -> TerrainRequest | None:
        """The question, None unless `due`; `steady` says that GNSS holds the autopilot's velocity."""
        node = self._track.at(t_ns)
        if node is None or not self.due(t_ns):
            return None
        span_s = (t_ns - self._soundings[0].at.t_ns) * 1e-9
        acceleration = STEADY_MPS2 if steady else DRIFTING_MPS2
        self._asked = _Asked(request_id, node, largest_sigma_m(prior.cov_ne_m2) > FAR_SIGMA_M, sigma_v_mps)
        return TerrainRequest(
            request_id,
            t_ns,
            prior,
            sigma_v_mps,
            acceleration,
            WANDER * acceleration * span_s**2 / 2,
            tuple(_row(one, node) for one in self._soundings),
            self._length_m(node) > LONGEST_M / GROWTH,
        )

    def answered(self, answer: Fix | NoFix) -> Fix | None:
        """Take the answer to the question that is open; the fix that the filter may have now, if any."""
        asked = self._asked
        if asked is None or asked.request_id != answer.request_id:
            return None
        self._asked = None
        if asked.ended:
            return None if asked.far or isinstance(answer, NoFix) else answer
        if isinstance(answer, NoFix):
            self._next_m = asked.at.flown_m + (GROWTH - 1) * self._length_m(asked.at)
            return None
        while self._soundings and self._soundings[0].at.t_ns <= asked.at.t_ns:
            self._soundings.popleft()
        self._next_m = 0.0
        before, self._waiting = self._waiting, (answer, asked) if asked.far else None
        if not asked.far:
            return answer
        return answer if before is not None and _agree(*before, answer, asked) else None

    def abandoned(self, request_id: int | None = None) -> None:
        """No answer will come: to this question, or to any (the worker ended)."""
        if self._asked is not None and request_id in (None, self._asked.request_id):
            self._asked = None

    def _length_m(self, node: Node) -> float:
        return node.flown_m - self._soundings[0].at.flown_m if self._soundings else 0.0


def _too_far(old: Node, now: Node) -> bool:
    return now.flown_m - old.flown_m > LONGEST_M or now.t_ns - old.t_ns > LONGEST_NS


def _row(one: _Sounded, now: Node) -> Sounding:
    """To the millisecond and centimetre: it is journalled."""
    at = one.at
    moved = (at.north_m - now.north_m, at.east_m - now.east_m, at.h_amsl_m - now.h_amsl_m)
    return (
        round((now.t_ns - at.t_ns) * 1e-9, 3),
        *(round(moved[0], 2), round(moved[1], 2), round(moved[2], 2)),
        *(round(one.beam_neu_m[0], 2), round(one.beam_neu_m[1], 2), round(one.beam_neu_m[2], 2)),
    )


def _agree(first: Fix, then: _Asked, second: Fix, now: _Asked) -> bool:
    """Whether two fixes of different stretches lie as far apart as the dead reckoning came between them."""
    dt_s = (now.at.t_ns - then.at.t_ns) * 1e-9
    north, east, _ = wgs84.ned_from_geo(second.place, first.place)
    off = np.array([north - (now.at.north_m - then.at.north_m), east - (now.at.east_m - then.at.east_m)])
    drifted = max(then.sigma_v_mps, now.sigma_v_mps) * dt_s + DRIFTING_MPS2 * dt_s**2 / 2
    S = np.array(first.cov_ne_m2) + np.array(second.cov_ne_m2) + drifted**2 * np.eye(2)
    return float(off @ np.linalg.solve(S, off)) <= AGREE_SIGMA**2
