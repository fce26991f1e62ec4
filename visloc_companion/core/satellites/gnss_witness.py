"""Grounds as witnesses against GNSS: over one ground a wrong match is found again, so all fixes over it are one witness.

Beside a true GNSS fixes are wrong by the same offset from one ground that the camera looked at first to another one, as votes.py
tells grounds apart, with the probability that the first of them claims times that of erring again over each further one. These
are the other causes (other_causes.py) that vision's test reckons with. Nothing else is needed for a ground over which fixes
agreed with GNSS before: an offset that began with the ground does not explain what came later. Nor does one where the first fix
lay where earlier ones had the vehicle: what it lay from there is what it is wrong by. Other methods fail for other reasons:
theirs are other causes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from visloc_companion.core.filter import votes
from visloc_companion.core.filter.separation import believed
from visloc_companion.core.satellites.other_causes import Cause
from visloc_companion.types import Vec2

SIZES_M = (10.0, 30.0)
"""1-sigma of a wrong match's offset per axis."""
REACH_M = 4 * SIZES_M[-1]
"""No search beside a trusted GNSS reaches further: what is further off is no wrong match. The test weighs such a difference down
(shift.py), so it would look as if it were one."""
FURTHER_ON, SAME_AGAIN = 0.4, 0.03
"""A fifth of a footprint on 43 of 107 wrong matches were wrong by the same offset (0.35: 18, half: 8), a footprint on one of them
(benchmarks/repeated.py, decision 70). The levels reckon with more (votes.py); these only say what GNSS is held against."""
NEGLIGIBLE = -16.0
"""Logarithm of a probability; what is less probable holds no test back (gnss_odds.py)."""
ANOTHER_SIGMA = 3.0
"""A fix so far from where earlier ones had the vehicle is another match of the same ground."""


class Ground(NamedTuple):
    """What a fix looked at: its method, where the ground lies (metres north, east of any place), how far on ground is other
    ground, and the probability of being wrong that the fix claims. `off_ne_m`: how far it lay from where earlier fixes had the
    vehicle, with the variance of that per axis; None where GNSS had a part in that."""

    method: str
    at_ne_m: Vec2
    spacing_m: float
    claimed: float
    off_ne_m: Vec2 | None = None
    off_var_m2: float = 0.0


class _Seen(NamedTuple):
    """A match: its number, where its ground lies and how far on is other ground, what its fixes claim in sum and how many they
    are, the logarithm of the probability that it errs with the one before, how its first fix lay, when it was seen last, and
    whether its ground was not new."""

    number: int
    at_ne_m: Vec2
    spacing_m: float
    claimed: float
    n: int
    log_again: float
    size: complex
    known: float
    t_ns: int
    another: bool

    @property
    def log_wrong(self) -> float:
        """Logarithm of the probability that it is wrong: of many claims of one match the mean is right, the largest is not."""
        return math.log(self.claimed / self.n)


Place = tuple[str, int]


class Grounds:
    """The last grounds that each method's fixes looked at, in the order in which they were first seen."""

    def __init__(self) -> None:
        self._seen: dict[str, list[_Seen]] = {}
        self._votes: votes.Votes = ()
        self._n: Counter[str] = Counter()

    def see(self, t_ns: int, ground: Ground) -> Place:
        """Take what a fix looked at; returns which ground that is."""
        method, at_ne_m, other_m = ground.method, ground.at_ne_m, ground.spacing_m
        seen, claimed = self._seen.setdefault(method, []), believed(ground.claimed)
        log_again = math.log(votes.errs_again(self._votes, method, at_ne_m, other_m, SAME_AGAIN, FURTHER_ON))
        self._votes = votes.voted(self._votes, method, t_ns, at_ne_m, other_m)
        off, var_m2 = ground.off_ne_m, ground.off_var_m2
        another = off is not None and math.hypot(*off) > ANOTHER_SIGMA * math.sqrt(var_m2)
        near = [k for k, each in enumerate(seen) if math.dist(each.at_ne_m, at_ne_m) < other_m]
        k = max(near, key=lambda i: (-math.dist(seen[i].at_ne_m, at_ne_m), i), default=0)
        if another or not near:
            self._n[method] += 1
            at_ne_m = seen[k].at_ne_m if near else at_ne_m  # it is the same ground still, or a row of others would lead away
            size, known = (0j, 0.0) if off is None else (-complex(*off), 1 / var_m2)  # GNSS minus fix moves the other way
            new = _Seen(self._n[method], at_ne_m, other_m, claimed, 1, log_again, size, known, t_ns, bool(near))
            seen.append(new)
            return method, new.number
        seen[k] = seen[k]._replace(claimed=seen[k].claimed + claimed, n=seen[k].n + 1, t_ns=t_ns)
        return method, seen[k].number

    def causes(self, shares: Mapping[Place, float]) -> list[Cause]:
        """What may be wrong alike, given the share of the newest fixes that looked at each ground: any stretch of grounds that
        were seen one after the other."""
        found = []
        for method, seen in self._seen.items():
            share_of = [shares.get((method, each.number), 0.0) for each in seen]
            for first, begun in enumerate(seen):
                log_p, adds, before = begun.log_wrong, 0.0, None
                for each, share in zip(seen[first:], share_of[first:], strict=True):
                    log_p += each.log_again if each is not begun else 0.0
                    if log_p < NEGLIGIBLE:
                        break
                    adds += share
                    key = method, begun.number, each.number
                    found.append(Cause(key, before, log_p, adds, begun.size, begun.known))
                    before = key
            self._seen[method] = _remembered(seen)
        return found


def _remembered(seen: list[_Seen]) -> list[_Seen]:
    """Of further matches of one ground the newest; as many as votes.py remembers, those that were seen last."""
    newest = [
        each
        for k, each in enumerate(seen)
        if not (each.another and any(n.another and math.dist(n.at_ne_m, each.at_ne_m) < n.spacing_m for n in seen[k + 1 :]))
    ]
    first_ns = sorted(each.t_ns for each in newest)[-votes.GROUNDS :][0] if newest else 0
    return [each for each in newest if each.t_ns >= first_ns]
