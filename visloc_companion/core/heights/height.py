"""How far the autopilot's height is off: a filter of its error against fixes, and the solutions that leave fixes out.

State (2,): `offset`, what must be added to the autopilot's height (a barometer's) at the start to get the true one, and `scale`,
by how much that changes with each metre climbed (air that is not the standard atmosphere's). The offset walks. Nothing of it is
sent to the autopilot: its height stays its own, and is judged here.

Neighbouring image fixes err alike: they look at the same ground, whose height the map has wrong, under the same tilt. So the
ground in view tells no more than its best fix; other ground, as it comes into view, tells its own. (As a state, what they share
would have two fixes that claim unlike errors conclude a height beyond both.)

A fix's height rests on the prior that its localiser was given, which is this height again: only what it adds is taken. A fix
beyond the gate is wrong, or the barometer jumped: until the next one decides, the level covers both; where one method says so
again and again and another decides otherwise, it goes on to. Solutions that leave fixes out: separation.py; the level that they
make: integrity.py.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from visloc_companion.core import integrity, kalman
from visloc_companion.core.filter import separation, votes
from visloc_companion.core.filter.alike import Alike, Taken, after_fix, none
from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.filter.separation import Solutions
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray, Rejected, Vec2

SCALE_SIGMA = 0.03
"""Air 9 degrees warmer or colder than the standard atmosphere's stretches heights by this share."""
GATE_SIGMA = 4.0
ORDINARY_SIGMA = 2.5
"""A fix further off, but not beyond the gate, is a sign of a barometer that drifts faster than it is taken to: the filter becomes
as unsure as makes the fix an ordinary one."""
HISTORY_NS = 6_000_000_000
JUMPED = 0.5
"""Probability that it was the barometer when one fix is refused: an assumption."""
LEAST_NEWS = 0.25
"""A fix that knows the height hardly better than its prior did says nothing: share of the prior's information. No claim is good
enough to tell a height from less: what a fix differs from its prior by is multiplied by five then."""
OVER_CLAIM = 1.5
"""What image fixes tell of the height errs by this share of the variance that they claim, nearly all of it in common."""
LEAST_ADDED = 0.01
"""A fix of ground that told as much before still adds this share of its information: a barometer may have drifted since."""
NEVER_OFF = none(2, 1)
NOTHING = Solutions(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0, np.int64))


@dataclass(frozen=True, slots=True, order=True)
class HeightFix:
    """What a fix says of the autopilot's height: raise it by `offset_m` (variance `var_m2`). It stood `climbed_m` over the start.

    `tie` orders fixes of one time. `gone_by_per_s`: the way in a second, over that after which fixes look at other ground;
    `at_ne_m`: the ground looked at (metres north, east of any place), ground `spacing_m` further on is other ground (votes.py).
    """

    t_ns: int
    tie: int
    offset_m: float
    var_m2: float
    climbed_m: float
    method: str
    probability_wrong: float
    gone_by_per_s: float = 0.0
    at_ne_m: Vec2 = (0.0, 0.0)
    spacing_m: float = votes.LEAST_SPACING_M


@dataclass(frozen=True, slots=True, eq=False)
class HeightBelief:
    """The filter at `t_ns`: mean x (2,), covariance P (2, 2), the time of the last fix that it rests on (or of its start), each
    method with the time of its last fix, the solutions that leave fixes out, and the last fix if it was refused. `told`: the
    information (1/m²) that image fixes of the ground in view have brought. `contradicting`: the last two fixes of each method
    that were refused since the filter agreed with one of it. `alike`: by what the correction may be off if fixes are wrong alike
    (alike.py)."""

    t_ns: int
    x: FloatArray
    P: FloatArray
    rested_ns: int
    votes: votes.Votes = ()
    without: Solutions = NOTHING
    refused: HeightFix | None = None
    told: float = 0.0
    contradicting: tuple[HeightFix, ...] = ()
    alike: Alike = NEVER_OFF


def started(t_ns: int, sigma_m: float, offset_m: float = 0.0) -> HeightBelief:
    """Before any fix: all that is known of the error is this 1-sigma about an offset."""
    return HeightBelief(t_ns, np.array([offset_m, 0.0]), np.diag([sigma_m**2, SCALE_SIGMA**2]), t_ns)


def carried(belief: HeightBelief, t_ns: int, settings: NavigatorSettings) -> HeightBelief:
    """The belief at a later time; the same for any division of the interval."""
    if t_ns <= belief.t_ns:
        return belief
    return _widened(belief, _walked_m2(belief, t_ns, settings), t_ns)


def _walked_m2(belief: HeightBelief, t_ns: int, settings: NavigatorSettings) -> float:
    return settings.height_walk_m_per_sqrt_s**2 * max(0, t_ns - belief.t_ns) * 1e-9


def observed(belief: HeightBelief, z: HeightFix, settings: NavigatorSettings) -> HeightBelief:
    """The belief at `z.t_ns` after a fix."""
    belief = carried(belief, z.t_ns, settings)
    var_m2, added, told = _news(belief, z)
    H = np.array([[1.0, z.climbed_m]])
    innovation2, expected_m2 = (z.offset_m - float(H[0] @ belief.x)) ** 2, float(H[0] @ belief.P @ H[0]) + var_m2
    if innovation2 > GATE_SIGMA**2 * expected_m2:
        if belief.refused is None or not _agree(belief.refused, z):
            return replace(belief, refused=z, contradicting=_contradicting(belief, z))
        belief, added = _widened(belief, innovation2), 1 / var_m2
    elif innovation2 > ORDINARY_SIGMA**2 * expected_m2:
        belief, added = _widened(belief, innovation2 / ORDINARY_SIGMA**2 - expected_m2), 1 / var_m2
    offset, R = np.array([z.offset_m]), np.array([[1 / added]])
    got = kalman.update(belief.x, belief.P, offset, R, H)
    if isinstance(got, Rejected):
        return belief
    voted = votes.voted(belief.votes, z.method, z.t_ns, z.at_ne_m, z.spacing_m)
    others = tuple(each for each in belief.contradicting if each.method != z.method)
    without = separation.apart(_others(belief, z, offset, R, H), got.x, got.P, H)
    alike = _alike(belief, got, z, R, H)
    return HeightBelief(z.t_ns, got.x, got.P, z.t_ns, voted, without, told=told, contradicting=others, alike=alike)


def _contradicting(belief: HeightBelief, z: HeightFix) -> tuple[HeightFix, ...]:
    own = [each for each in belief.contradicting if each.method == z.method]
    return (*(each for each in belief.contradicting if each.method != z.method), *own[-1:], z)


def _repeated(belief: HeightBelief, t_ns: int) -> list[HeightFix]:
    """What a method has said twice lately and the filter, which takes the fixes of another, has refused both times."""
    lately = [each for each in belief.contradicting if t_ns - each.t_ns <= votes.RECENT_NS]
    return [b for a, b in pairwise(lately) if a.method == b.method and _agree(a, b)]


def _news(belief: HeightBelief, z: HeightFix) -> tuple[float, float, float]:
    """Variance of what a fix says, the information that it adds to what ground in view has told, and what that has told then."""
    seconds = max(0, z.t_ns - belief.rested_ns) * 1e-9
    gone_by = z.gone_by_per_s * seconds / 2  # half: errors of a Gauss-Markov process tell less than new ground
    told = belief.told * math.exp(-gone_by)
    if z.method in BY_SHAPE:
        return z.var_m2, 1 / z.var_m2, told
    var_m2 = OVER_CLAIM * z.var_m2
    added = max(1 / var_m2 - told, LEAST_ADDED / var_m2)
    return var_m2, added, told + added


def _agree(a: HeightFix, b: HeightFix) -> bool:
    return (a.offset_m - b.offset_m) ** 2 <= GATE_SIGMA**2 * (a.var_m2 + b.var_m2)


def _others(belief: HeightBelief, z: HeightFix, offset: FloatArray, R: FloatArray, H: FloatArray) -> Solutions:
    among = belief.without
    take = ~separation.leaving_out(among, z.method)
    among = separation.updated(among, offset, R, H, take=take, n_considered=0, t_ns=z.t_ns)
    recent = votes.recent(belief.votes, z.t_ns)
    return separation.without_fix(among, z.method, z.probability_wrong, (belief.x, belief.P, belief.rested_ns), recent)


def _alike(belief: HeightBelief, got: kalman.Updated, z: HeightFix, R: FloatArray, H: FloatArray) -> Alike:
    """What the correction is off by if fixes are wrong alike, after one of H x, H (1, 2), with R (1, 1)."""
    again = votes.errs_again(belief.votes, z.method, z.at_ne_m, z.spacing_m)
    gain = kalman.gain(belief.P, R, H)
    return after_fix(belief.alike, Taken(z.t_ns, z.method, z.probability_wrong, again, got.innovation, got.seen + R, H, gain))


def _widened(belief: HeightBelief, more_m2: float, t_ns: int | None = None) -> HeightBelief:
    """With a variance added to the offset, at a time where that is another."""
    P = belief.P.copy()
    P[0, 0] += more_m2
    without = belief.without
    if len(without):
        others = without.P.copy()
        others[:, 0, 0] += more_m2
        without = replace(without, then=others)
    return replace(belief, t_ns=belief.t_ns if t_ns is None else t_ns, P=P, without=without)


class HeightFilter:
    """Folds fixes in the order of their times, so that a late one changes nothing but what came after it."""

    def __init__(self, settings: NavigatorSettings, t_ns: int, h_amsl_m: float, sigma_m: float, offset_m: float = 0.0) -> None:
        self._settings, self._start_amsl_m = settings, h_amsl_m
        self._base = started(t_ns, sigma_m, offset_m)
        self._log: list[HeightFix] = []
        self._beliefs: list[HeightBelief] = []
        self._jumps: list[tuple[int, float]] = []

    @property
    def newest(self) -> HeightBelief:
        """After the last fix."""
        return self._beliefs[-1] if self._beliefs else self._base

    def observe(self, fix: HeightFix) -> bool:
        """Take a fix; False for one that is older than the memory."""
        if fix.t_ns < self._base.t_ns:
            return False
        at = bisect_right(self._log, fix)
        self._log.insert(at, fix)
        self._fold(at)
        horizon_ns = self._log[-1].t_ns - HISTORY_NS
        n_old = bisect_left(self._log, horizon_ns, key=lambda entry: entry.t_ns)
        if n_old:
            self._base = self._beliefs[n_old - 1]
            del self._log[:n_old], self._beliefs[:n_old]
            self._jumps = [jump for jump in self._jumps if jump[0] > self._base.t_ns]
        return True

    def jumped(self, t_ns: int, var_m2: float) -> None:
        """The autopilot's height changed at a time by more than its climb: how far it is off is less known by this variance."""
        self._jumps.append((t_ns, var_m2))
        self._merge_old_jumps(t_ns - HISTORY_NS)
        self._fold(bisect_right(self._log, t_ns, key=lambda entry: entry.t_ns))

    def _merge_old_jumps(self, horizon_ns: int) -> None:
        """One doubt of all those since the newest fix that no fix will come between any more."""
        old = [jump for jump in self._jumps if self.newest.t_ns < jump[0] <= horizon_ns]
        if len(old) > 1:
            merged = (max(t_ns for t_ns, _ in old), sum(var_m2 for _, var_m2 in old))
            self._jumps = [merged, *(jump for jump in self._jumps if jump not in old)]

    def _fold(self, at: int) -> None:
        del self._beliefs[at:]
        for entry in self._log[at:]:
            self._beliefs.append(observed(self._doubted(entry.t_ns), entry, self._settings))

    def _doubted(self, t_ns: int) -> HeightBelief:
        """The newest belief with the doubt of jumps until a time; what ground in view has told was of the height before."""
        belief = self.newest
        if not self._jumps:
            return belief
        more_m2 = sum(var_m2 for jumped_ns, var_m2 in self._jumps if belief.t_ns < jumped_ns <= t_ns)
        return replace(_widened(belief, more_m2), told=0.0) if more_m2 else belief

    def climbed_m(self, h_amsl_m: float) -> float:
        """How far an autopilot's height lies above that of the start."""
        return h_amsl_m - self._start_amsl_m

    def at(self, t_ns: int, h_amsl_m: float) -> tuple[float, float]:
        """By how much an autopilot's height at a time must be raised, and the variance of that."""
        belief, climbed_m = self._doubted(t_ns), self.climbed_m(h_amsl_m)
        offset_m, scale = belief.x.tolist()
        (offset_m2, both_m), (_, scale2) = belief.P.tolist()
        walked_m2 = _walked_m2(belief, t_ns, self._settings)
        return offset_m + climbed_m * scale, offset_m2 + walked_m2 + climbed_m * (2 * both_m + climbed_m * scale2)

    def protection_level_m(self, t_ns: int, h_amsl_m: float, height_above_home_m: float) -> float:
        """Bound of the error of an autopilot's height at a time (integrity.py)."""
        belief, climbed_m = self._doubted(t_ns), self.climbed_m(h_amsl_m)
        walked_m2, without, alike = _walked_m2(belief, t_ns, self._settings), belief.without, belief.alike
        H = np.array([1.0, climbed_m])
        var_of = np.array([1.0, climbed_m, climbed_m, climbed_m * climbed_m])  # of a covariance (2, 2), row by row
        ours_m, ours_m2 = float(H.dot(belief.x)), float(var_of.dot(belief.P.ravel())) + walked_m2
        refused = [] if belief.refused is None else [belief.refused]
        known = [(each.offset_m, each.var_m2, JUMPED) for each in (*refused, *_repeated(belief, t_ns))]
        n, K = 1 + len(known), 1 + len(known) + len(without)
        offset_m, var_m2, probability = np.empty((3, K + len(alike)))
        offset_m[:n], var_m2[:n], probability[:n] = zip((ours_m, ours_m2, 1.0), *known, strict=True)
        off_m, spread_m2 = alike.off_m(H[None])
        offset_m[n:K], offset_m[K:] = without.x.dot(H), ours_m - off_m[0]
        var_m2[n:K], var_m2[K:] = without.P.reshape(-1, 4).dot(var_of) + walked_m2, ours_m2 + spread_m2[0]
        probability[n:K], probability[K:] = without.probability, alike.probability
        return integrity.vertical_protection_level_m(offset_m, var_m2, probability, height_above_home_m, self._settings)


def news_of(h_amsl_m: float, sigma_m: float, prior_amsl_m: float, prior_sigma_m: float) -> tuple[float, float] | None:
    """Height and variance that a fix adds to the prior of its request; None where it adds next to nothing.

    Both are Gaussian, so the fix's information is the sum of the prior's and its own.
    """
    whole, known = sigma_m**-2, prior_sigma_m**-2
    own = whole - known
    if own < LEAST_NEWS * known:
        return None
    return (whole * h_amsl_m - known * prior_amsl_m) / own, 1 / own
