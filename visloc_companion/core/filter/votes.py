"""What each method said last, and the probability that its next fix errs with that one: it depends on the ground looked at.

A wrong match is one of a picture of ground: over the same ground it is found again, however often one looks, and over other
ground it is not (benchmarks/repeated.py, decision 70). So a fix counts against those before it only where the camera looks at
other ground than at the last one that counted, be it that the vehicle has gone on or that the camera was turned (decision 72).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.geo.se3 import down_axis
from visloc_companion.types import Fix, Vec2

RECENT_NS = 30_000_000_000
"""Methods whose fixes are no older than this are votes beside each other."""
CORRELATION = 0.5
"""Probability that a fix of a method errs with the last one where it looks at ground that lies SPACING further on, halved for
each ..."""
SPACING = 0.2
"""... which is a share of what the camera sees across, ..."""
ACROSS = 1.2
"""... where that is not told so many heights above the ground, as a camera of 60 degrees sees, ..."""
LEAST_SPACING_M = 8.0
"""... and never less than this, ..."""
LEAST = 0.1
"""... but not less than this, for land repeats itself. A method that looks at shapes sees more of the way than a frame does: for
it not less than CORRELATION, which is assumed."""

GROUNDS = 12
"""Ground that was looked at so many spacings ago is the same ground still: who sways or turns about a place sees nothing new."""
FLATTEST = 3.0
"""Tangent of the lean beyond which what a camera looks at is no longer told from its attitude."""


class Vote(NamedTuple):
    """A method, the time of its last fix, and the ground (metres north, east) that its last fixes that counted looked at."""

    method: str
    t_ns: int
    seen_ne_m: tuple[Vec2, ...]


Votes = tuple[Vote, ...]


def spacing_m(footprint_m: float | None, height_m: float) -> float:
    """How far on ground must lie to be other ground, for a camera that sees so much across from a height above the ground."""
    return max(LEAST_SPACING_M, SPACING * (ACROSS * height_m if footprint_m is None else footprint_m))


def looked_at(fix: Fix, height_m: float) -> tuple[Vec2, float]:
    """Metres north and east from the camera of a fix to the ground that it looks at, and how far on ground is other ground;
    `height_m`: the camera's over the ground, where the fix does not tell it."""
    over_ground_m = height_m if fix.above_ground_m is None else fix.above_ground_m
    return view_ne_m(fix, over_ground_m), spacing_m(fix.footprint_m, over_ground_m)


def view_ne_m(fix: Fix, height_m: float) -> Vec2:
    """(2,) metres north and east from the camera to the ground that it looks at, from a height above the ground; no further than
    it sees under FLATTEST."""
    north, east, down = down_axis(fix.q_ned_frd)
    flat = math.hypot(north, east)
    away_m = max(0.0, height_m) * min(FLATTEST, flat / down if down > 0 else FLATTEST)
    return (0.0, 0.0) if flat == 0 else (away_m * north / flat, away_m * east / flat)


def voted(votes: Votes, method: str, t_ns: int, at_ne_m: Vec2, other_m: float) -> Votes:
    """With a fix of a method that looks at ground there; what is `other_m` further on is other ground."""
    last = _last(votes, method)
    seen = () if last is None else last.seen_ne_m
    if not seen or _away_m(seen, at_ne_m) >= other_m:
        seen = (*seen[1 - GROUNDS :], at_ne_m)
    return (*(other for other in votes if other.method != method), Vote(method, t_ns, seen))


def moved(votes: Votes, by_ne_m: Vec2) -> Votes:
    """With all places moved, as an origin is, or a filter that starts again elsewhere."""
    north, east = by_ne_m
    return tuple(v._replace(seen_ne_m=tuple((n + north, e + east) for n, e in v.seen_ne_m)) for v in votes)


def recent(votes: Votes, t_ns: int) -> frozenset[str]:
    """The methods that have given a fix lately."""
    return frozenset(vote.method for vote in votes if t_ns - vote.t_ns <= RECENT_NS)


def errs_again(
    votes: Votes, method: str, at_ne_m: Vec2, other_m: float, least: float = LEAST, further_on: float = CORRELATION
) -> float:
    """Probability that a fix of a method that looks at ground there errs with its last one if that was wrong; 1 over the same
    ground, where it says nothing new, and where the last one is not known; `further_on` a spacing on, never less than `least`."""
    last = _last(votes, method)
    if last is None:
        return 1.0
    spacings = _away_m(last.seen_ne_m, at_ne_m) / other_m
    return 1.0 if spacings < 1 else max(CORRELATION if method in BY_SHAPE else least, further_on**spacings)


def _away_m(seen_ne_m: tuple[Vec2, ...], at_ne_m: Vec2) -> float:
    return min([math.dist(at_ne_m, each) for each in seen_ne_m])


def _last(votes: Votes, method: str) -> Vote | None:
    return next((vote for vote in votes if vote.method == method), None)
