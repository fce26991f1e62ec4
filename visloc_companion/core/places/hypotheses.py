"""Several places where the vehicle may be, held against what the camera sees until one of them is left.

Each hypothesis is a Kalman filter of its own: position, and the error of the velocity that carries it. It is tested by a search
about it in a new frame. Its log odds against "none of them" change by the sequential probability ratio (Wald 1945): what is the
chance of that answer where the vehicle is there, and where it is not? Answers to frames of the same ground are not independent,
so one counts only when the vehicle has moved on by `spacing_m`. A place that repeats itself never wins: against another place
that was seen as well, no more answers count than that one was asked for, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.types import Cov2, FloatArray, Rejected, Vec2

H_POSITION: FloatArray = np.eye(2, 4)
FIRST_LOG_ODDS = math.log(1 / 40)
"""Of a place that a search of a large region lists."""
SEEN, SEEN_BY_MISTAKE = 0.8, 0.005
"""Probability of a fix that agrees with the motion where the vehicle is, and where it is not."""
SURE_BY_MISTAKE = 0.0035
"""The latter of a fix that is sure (place_search.py): of some 1,350 tests elsewhere one gave a fix that counts, sure or not, so
that it is less with 95 % confidence."""
HIT, MISS = math.log(SEEN / SEEN_BY_MISTAKE), math.log((1 - SEEN) / (1 - SEEN_BY_MISTAKE))
SURE_HIT = math.log(SEEN / SURE_BY_MISTAKE)
GATE_SIGMA = 4.0
HOPELESS_LOG_ODDS = FIRST_LOG_ODDS + 1.5 * MISS
"""What was never seen is given up after two misses; a later sweep may list it again."""
FEWEST_HITS, FEWEST_SURE_HITS = 4, 3
"""So many answers find a place at least; fewer where each of them is sure of itself and all of the map was searched meanwhile."""
MISS_EVERY_NS = 2_000_000_000
"""Without a fix nobody knows how far the vehicle came: misses count once in so long."""
VELOCITY_WALK = 0.5
"""m/s per root second that the velocity input's error wanders (1-sigma): a turn, where the input knows of none."""
SAME_SIGMA = 3.0
MOST = 40


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A place at `t_ns`: x (4,) metres north, east and the error of the velocity input (m/s), with covariance P (4, 4).

    `hits` and `misses` are answers that count, `sure_hits` those hits that were sure; `counted_ne_m` is where the last hit was,
    `spacing_m` how far from there the next one counts, `missed_ns` the time of the last miss.
    """

    number: int
    t_ns: int
    x: FloatArray
    P: FloatArray
    log_odds: float = FIRST_LOG_ODDS
    hits: int = 0
    sure_hits: int = 0
    misses: int = 0
    counted_ne_m: Vec2 | None = None
    spacing_m: float = 0.0
    missed_ns: int | None = None
    tested_ns: int | None = None

    @property
    def place_ne_m(self) -> Vec2:
        """Metres north and east."""
        return float(self.x[0]), float(self.x[1])

    @property
    def cov_ne_m2(self) -> Cov2:
        """Of the position."""
        return (float(self.P[0, 0]), float(self.P[0, 1])), (float(self.P[0, 1]), float(self.P[1, 1]))

    @property
    def velocity_error_mps(self) -> Vec2:
        """What was learnt of the velocity input's error (input minus truth), north and east."""
        return float(self.x[2]), float(self.x[3])


@dataclass(frozen=True, slots=True)
class Travel:
    """How far the vehicle came over `dt_s`, metres north and east, with the covariance of what was measured of it; `by_velocity`:
    from the velocity input, whose error counts, and not from odometry."""

    moved_ne_m: Vec2
    cov_ne_m2: Cov2
    dt_s: float
    by_velocity: bool


def born(number: int, t_ns: int, place_ne_m: Vec2, sigma_m: float, sigma_v_mps: float) -> Hypothesis:
    """A place that a search lists; 1-sigma per axis of it and of the velocity input."""
    x = np.array([*place_ne_m, 0.0, 0.0])
    return Hypothesis(number, t_ns, x, np.diag([sigma_m**2, sigma_m**2, sigma_v_mps**2, sigma_v_mps**2]))


def carried(h: Hypothesis, t_ns: int, travel: Travel) -> Hypothesis:
    """The hypothesis at a later time."""
    F = np.eye(4)
    if travel.by_velocity:
        F[:2, 2:] = -travel.dt_s * np.eye(2)
    Q = np.zeros((4, 4))
    Q[:2, :2] = travel.cov_ne_m2
    Q[2:, 2:] = VELOCITY_WALK**2 * travel.dt_s * np.eye(2)
    x, P = kalman.predict(h.x, h.P, F, Q, np.array([*travel.moved_ne_m, 0.0, 0.0]))
    return replace(h, t_ns=t_ns, x=x, P=P)


def confirmed(h: Hypothesis, place_ne_m: Vec2, cov_ne_m2: Cov2, spacing_m: float, sure: bool = False) -> Hypothesis:
    """After a fix in a search about it. One that the motion does not lead to is a miss."""
    updated = _updated(h, place_ne_m, cov_ne_m2)
    if isinstance(updated, Rejected):
        return missed(h)
    taken = replace(h, x=updated.x, P=updated.P, tested_ns=h.t_ns)
    if h.counted_ne_m is not None and math.dist(h.counted_ne_m, place_ne_m) < spacing_m:
        return taken
    log_odds = h.log_odds + (SURE_HIT if sure else HIT)
    hits, sure_hits = h.hits + 1, h.sure_hits + sure
    return replace(taken, log_odds=log_odds, hits=hits, sure_hits=sure_hits, counted_ne_m=place_ne_m, spacing_m=spacing_m)


def leads_to(h: Hypothesis, place_ne_m: Vec2, cov_ne_m2: Cov2) -> bool:
    """Whether its motion leads to a place."""
    return not isinstance(_updated(h, place_ne_m, cov_ne_m2), Rejected)


def _updated(h: Hypothesis, place_ne_m: Vec2, cov_ne_m2: Cov2) -> kalman.Updated | Rejected:
    return kalman.update(h.x, h.P, np.array(place_ne_m), np.array(cov_ne_m2), H_POSITION, gate_sigma=GATE_SIGMA)


def missed(h: Hypothesis) -> Hypothesis:
    """After a search about it that found nothing."""
    if h.missed_ns is not None and h.t_ns - h.missed_ns < MISS_EVERY_NS:
        return untold(h)
    return replace(h, log_odds=h.log_odds + MISS, misses=h.misses + 1, missed_ns=h.t_ns, tested_ns=h.t_ns)


def untold(h: Hypothesis) -> Hypothesis:
    """After a search about it in a frame that shows nothing anywhere."""
    return replace(h, tested_ns=h.t_ns)


def kept(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The likeliest MOST of them, best first, without those that are hopeless or lie where a better one does."""
    best: list[Hypothesis] = []
    for h in sorted(hypotheses, key=lambda h: (-h.log_odds, h.number)):
        if h.log_odds > HOPELESS_LOG_ODDS and not any(same(h, other) for other in best):
            best.append(h)
    return tuple(best[:MOST])


def same(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two hypotheses of one time are one place as far as can be told; the velocity's error is the same for both."""
    d = a.x[:2] - b.x[:2]
    return float(d @ np.linalg.solve(_own_m2(a.P) + _own_m2(b.P), d)) <= SAME_SIGMA**2


def _own_m2(P: FloatArray) -> FloatArray:
    """(2, 2) covariance of the position were the velocity's error known."""
    return np.asarray(P[:2, :2] - P[:2, 2:] @ np.linalg.solve(P[2:, 2:], P[2:, :2]))


def probability_wrong(h: Hypothesis, others: Sequence[Hypothesis]) -> float:
    """Of the statement that the vehicle is at this hypothesis' place, not at another one's nor anywhere else."""
    against = math.exp(-h.log_odds) + sum(math.exp(min(0.0, -lead(h, o))) for o in others if o.number != h.number)
    return against / (1 + against)


def lead(h: Hypothesis, other: Hypothesis) -> float:
    """Log odds against another hypothesis; where that was seen too, of as many answers as it had."""
    ahead = h.log_odds - other.log_odds
    if not other.hits:
        return ahead
    answers = min(h.hits, other.hits + other.misses)
    return min(ahead, HIT * (answers - other.hits) + MISS * (h.misses - other.misses))


def winner(hypotheses: Sequence[Hypothesis], risk: float, swept: bool = False) -> Hypothesis | None:
    """The hypothesis that is wrong with a probability of at most `risk` and was seen often enough, if there is one; `swept`: a
    place that looks the same would have been looked at, wherever on the map it is."""
    for h in hypotheses:
        seen = h.hits >= FEWEST_HITS or (swept and h.sure_hits >= FEWEST_SURE_HITS)
        if seen and probability_wrong(h, hypotheses) <= risk:
            return h
    return None
