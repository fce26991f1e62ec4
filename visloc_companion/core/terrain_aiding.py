"""Soundings along the track: distances measured downwards become a profile of the ground, and the worker is asked where it fits.

The track is dead reckoning by the autopilot's velocity, never corrected by fixes: a correction amid a profile would bend it. A
stretch is asked about when it is long enough and again each time it has grown; what is refused is kept and joined with what
comes, what was accepted is never used twice. From far off a first answer waits for a second one that agrees with it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.estimator import Velocity
from visloc_companion.core.integrity import largest_sigma_m
from visloc_companion.geo import se3, wgs84
from visloc_companion.types import Fix, GeoPoint, NavState, NoFix, PosePrior, Quat, Range, Sounding, TerrainRequest, Vec2, Vec3

METHOD = "terrain"
SPACING_M = 5.0
"""Of each so much of the track the lowest sounding is kept: where crowns have gaps, that is the ground."""
SHORTEST_M, LONGEST_M, GROWTH = 600.0, 8000.0, 1.3
LONGEST_NS = 400_000_000_000
MAX_GAP_NS = 1_000_000_000
"""Velocities further apart end the stretch: how far the vehicle came meanwhile is not known."""
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


LEARN_AFTER_S, MAX_LEARNED_MPS = 10.0, 10.0
FORGOTTEN_S = 2.0
"""A learnt error of the velocity is taken off for about this time: until the autopilot, to which the corrected position is
injected, has corrected its own velocity. One that is quicker is corrected wholly, a slower one in part, none too much."""


@dataclass(frozen=True, slots=True)
class _Node:
    """Dead reckoning at a time: metres north and east of where it began, of track flown, and the height above sea level."""

    t_ns: int
    north_m: float
    east_m: float
    flown_m: float
    h_amsl_m: float


@dataclass(frozen=True, slots=True)
class _Sounded:
    """A sounding with the dead reckoning of its time; `beam_neu_m` from the vehicle to the surface."""

    at: _Node
    beam_neu_m: tuple[float, float, float]

    @property
    def surface_m(self) -> float:
        return self.at.h_amsl_m + self.beam_neu_m[2]


@dataclass(frozen=True, slots=True)
class _Asked:
    """What was asked: the dead reckoning then, and whether the prior was far off."""

    request_id: int
    at: _Node
    far: bool
    sigma_v_mps: float


class TerrainAiding:
    """Collects, decides when to ask, and holds back what stands alone. The navigator calls it, in order of time."""

    def __init__(self) -> None:
        self._velocity: Velocity | None = None
        self._now: _Node | None = None
        self._soundings: deque[_Sounded] = deque()
        self._lowest: _Sounded | None = None
        self._next_m, self._cell = 0.0, 0
        self._asked: _Asked | None = None
        self._waiting: tuple[Fix, _Asked] | None = None
        self._learned: tuple[int, Vec2] = (0, (0.0, 0.0))

    def clear(self) -> None:
        """Forget the stretch (the track is interrupted)."""
        self._velocity = self._now = self._lowest = self._waiting = None
        self._soundings.clear()
        self._next_m, self._cell = 0.0, 0

    def learn(self, fix: Fix, state: NavState, origin: GeoPoint) -> None:
        """What a fix that the filter took says of the velocity since the last one; `state` is the filter's without it."""
        north, east, _ = wgs84.ned_from_geo(fix.place, origin)
        off_north, off_east = state.p_ned_m[0] - north, state.p_ned_m[1] - east
        squared, noise = off_north**2 + off_east**2, largest_sigma_m(fix.cov_ne_m2) ** 2
        if state.age_of_fix_s >= LEARN_AFTER_S and squared > noise:
            share = min((1 - noise / squared) / state.age_of_fix_s, MAX_LEARNED_MPS / math.sqrt(squared))
            self._learned = (fix.t_ns, (share * off_north, share * off_east))

    def corrected(self, t_ns: int, v_ned_mps: Vec3) -> Vec3:
        """A velocity of the autopilot that descends from injected positions, less what was learnt of its error."""
        learned_ns, (north, east) = self._learned
        left = math.exp(-max(0, t_ns - learned_ns) * 1e-9 / FORGOTTEN_S)
        return v_ned_mps[0] - left * north, v_ned_mps[1] - left * east, v_ned_mps[2]

    def drive(self, velocity: Velocity) -> None:
        """Carry the dead reckoning on by a velocity sample."""
        last, now = self._velocity, self._now
        gap_ns = 0 if last is None else velocity.t_ns - last.t_ns
        other = last is not None and last.drive is not velocity.drive  # another velocity, with another error
        if last is None or now is None or other or not 0 < gap_ns <= MAX_GAP_NS:
            self.clear()
            self._velocity, self._now = velocity, _Node(velocity.t_ns, 0.0, 0.0, 0.0, velocity.h_amsl_m)
            return
        (n0, e0, _), (n1, e1, _) = last.v_ned_mps, velocity.v_ned_mps
        self._velocity = velocity
        self._now = _moved(now, gap_ns, ((n0 + n1) / 2, (e0 + e1) / 2), velocity.h_amsl_m)

    def on_range(self, event: Range, t_ns: int, q_ned_frd: Quat) -> None:
        """Take a distance along the body's down axis, measured at a time and attitude."""
        node, down = self._at(t_ns), se3.rotate(q_ned_frd, (0.0, 0.0, 1.0))
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
        node = self._at(t_ns)
        long_enough = node is not None and node.flown_m >= self._next_m and self._length_m(node) >= SHORTEST_M
        return long_enough and self._asked is None and len(self._soundings) >= FEWEST

    def request(self, request_id: int, t_ns: int, prior: PosePrior, sigma_v_mps: float, steady: bool) -> TerrainRequest | None:
        """The question, None unless `due`; `steady` says that GNSS holds the autopilot's velocity."""
        node = self._at(t_ns)
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

    def _at(self, t_ns: int) -> _Node | None:
        """The dead reckoning at a time near the last velocity sample."""
        now, velocity = self._now, self._velocity
        if now is None or velocity is None or abs(t_ns - now.t_ns) > MAX_GAP_NS:
            return None
        v_north, v_east, v_down = velocity.v_ned_mps
        since_ns = t_ns - now.t_ns
        return _moved(now, since_ns, (v_north, v_east), now.h_amsl_m - v_down * since_ns * 1e-9)

    def _length_m(self, node: _Node) -> float:
        return node.flown_m - self._soundings[0].at.flown_m if self._soundings else 0.0


def _moved(node: _Node, dt_ns: int, v_ne_mps: Vec2, h_amsl_m: float) -> _Node:
    dt_s = dt_ns * 1e-9
    north, east = v_ne_mps[0] * dt_s, v_ne_mps[1] * dt_s
    flown = node.flown_m + math.copysign(math.hypot(north, east), dt_s)
    return _Node(node.t_ns + dt_ns, node.north_m + north, node.east_m + east, flown, h_amsl_m)


def _too_far(old: _Node, now: _Node) -> bool:
    return now.flown_m - old.flown_m > LONGEST_M or now.t_ns - old.t_ns > LONGEST_NS


def _row(one: _Sounded, now: _Node) -> Sounding:
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
