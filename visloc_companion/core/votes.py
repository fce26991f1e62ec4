"""What each method said last, and the probability that its next fix errs with that one: it depends on the ground looked at.

A wrong match is one of a picture of ground: over the same ground it is found again, however often one looks, and over other
ground it is not (benchmarks/repeated.py, decision 70). So a fix counts against those before it only where the vehicle has gone
on since the last one that counted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from visloc_companion.core.lasting import BY_SHAPE
from visloc_companion.types import Vec2

RECENT_NS = 30_000_000_000
"""Methods whose fixes are no older than this are votes beside each other."""
CORRELATION = 0.5
"""Probability that a fix of a method errs with the last one where the vehicle has gone on by SPACING, halved for each ..."""
SPACING = 0.4
"""... which is a share of the way after which fixes look at other ground (lasting.apart_m): a fifth of what the camera sees
across ..."""
LEAST = 0.1
"""... but not less than this, for land repeats itself. A method that looks at shapes sees more of the way than a frame does: for
it not less than CORRELATION, which is assumed."""


class Vote(NamedTuple):
    """A method, the time of its last fix, and where the vehicle was at the last one that counted (metres north and east; the
    height's filter: the way so far, in ways after which fixes look at other ground)."""

    method: str
    t_ns: int
    at_ne_m: Vec2


Votes = tuple[Vote, ...]


def voted(votes: Votes, method: str, t_ns: int, at_ne_m: Vec2 = (0.0, 0.0), apart_m: float = math.inf) -> Votes:
    """With a fix of a method, of a vehicle that is there, if that matters."""
    last = _last(votes, method)
    at = at_ne_m if last is None or math.dist(at_ne_m, last.at_ne_m) >= SPACING * apart_m else last.at_ne_m
    return (*(other for other in votes if other.method != method), Vote(method, t_ns, at))


def moved(votes: Votes, by_ne_m: Vec2) -> Votes:
    """With all places moved, as an origin is, or a filter that starts again elsewhere."""
    north, east = by_ne_m
    return tuple(v._replace(at_ne_m=(v.at_ne_m[0] + north, v.at_ne_m[1] + east)) for v in votes)


def recent(votes: Votes, t_ns: int) -> frozenset[str]:
    """The methods that have given a fix lately."""
    return frozenset(vote.method for vote in votes if t_ns - vote.t_ns <= RECENT_NS)


def errs_again(votes: Votes, method: str, at_ne_m: Vec2, apart_m: float) -> float:
    """Probability that a fix of a method, of a vehicle that is there, errs with its last one if that was wrong; 1 over the same
    ground, where it says nothing new, and where the last one is not known."""
    last = _last(votes, method)
    if last is None:
        return 1.0
    spacings = math.dist(at_ne_m, last.at_ne_m) / (SPACING * apart_m)
    return 1.0 if spacings < 1 else max(CORRELATION if method in BY_SHAPE else LEAST, CORRELATION**spacings)


def _last(votes: Votes, method: str) -> Vote | None:
    return next((vote for vote in votes if vote.method == method), None)
