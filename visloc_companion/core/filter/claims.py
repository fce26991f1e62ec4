"""By how much fixes of a method err more than they claim, learned from how they scatter about the filter.

Innovations made white by their covariance have variance 1 on each axis while all claims hold, and differences of two in a row
have twice that. Where both are larger, what the method claims is raised until one is not (stochastic approximation: Robbins and
Monro, 1951). Innovations alone are as large where a velocity is held wrong, which has all of them to one side and is no fix's
fault; differences alone are as large where neighbouring fixes have less in common than they are taken to. Claims are never
lowered, and those that hold are left exactly as they are.

That takes some dozens of fixes, and longer beside a GNSS that holds the filter. Before it is learned, by how much neighbouring
fixes lie apart beyond the vehicle's motion tells whether they may speak against GNSS (`scattered`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from visloc_companion.types import Vec2

GAIN = 0.05
"""Of the suspicion's logarithm, for each fix: a hundred fixes or so learn a factor of 25, and as many forget it."""
CHANCE = 1.5
"""Suspicion up to this is what honest fixes come to by chance."""
MOST = 100.0
MOST_SQUARED = 8.0
"""No fix counts for more: one that is wrong says nothing of the others."""
NEIGHBOURS_S = 2.0
"""Fixes further apart in time are none: the motion between them errs by as much as they."""
NEWEST, HONEST = 16, 3
"""So many distances of neighbours count, beside so many that are what they should be."""
MOST_APART_SQUARED = 32.0
"""No distance counts for more: one wrong fix has two that are long."""


class Apart(NamedTuple):
    """Of a method's last fixes: where the last one had the vehicle, less what that moved (metres north, east), its time and the
    variance per axis that it claimed; half the squares of how far neighbours were apart, over what they claim."""

    at_ne_m: Vec2
    t_ns: int
    claimed_m2: float
    squares: tuple[float, ...] = ()

    @property
    def over(self) -> float:
        """By what factor the variance of fixes is larger than they claim, by the mean of those squares, at least 1."""
        return max(1.0, (sum(self.squares) + HONEST) / (len(self.squares) + HONEST) / CHANCE)

    def then(self, other: Apart, sigma_v_mps: float) -> Apart:
        """With the next fix; `sigma_v_mps`: of the velocity (1-sigma per axis) that tells the motion in between."""
        dt_s = (other.t_ns - self.t_ns) * 1e-9
        if not 0 < dt_s <= NEIGHBOURS_S:
            return self if dt_s <= 0 else other._replace(squares=self.squares)
        var_m2 = self.claimed_m2 + other.claimed_m2 + (sigma_v_mps * dt_s) ** 2
        square = math.dist(self.at_ne_m, other.at_ne_m) ** 2 / 2 / var_m2
        return other._replace(squares=(*self.squares, min(square, MOST_APART_SQUARED))[-NEWEST:])


def scattered(claims: tuple[Claim, ...], method: str) -> float:
    """The factor of a method's variance for who compares its fixes with something else than the filter, at least 1."""
    found = _of(claims, method)
    return 1.0 if found is None else max(found.over, found.apart.over if found.apart else 1.0)


@dataclass(frozen=True, slots=True)
class Claim:
    """Of a method: how far its claims are suspected, at least 1, and the whitened innovation of its last fix that was taken; how
    far its last fixes lay apart."""

    method: str
    suspicion: float
    white_ne: Vec2
    apart: Apart | None = None

    @property
    def over(self) -> float:
        """By what factor the variance of its fixes is larger than they claim, at least 1."""
        return max(1.0, self.suspicion / CHANCE)


def over(claims: tuple[Claim, ...], method: str) -> float:
    """The factor of a method's variance."""
    found = _of(claims, method)
    return 1.0 if found is None else found.over


def learned(
    claims: tuple[Claim, ...], method: str, white_ne: Vec2, apart: Apart | None = None, sigma_v_mps: float = 0.0
) -> tuple[Claim, ...]:
    """After a fix that the filter took, with its innovation made white by what it was taken to err by; where it lay, and how well
    the velocity is known (1-sigma per axis) since the one before."""
    before = _of(claims, method) or Claim(method, 1.0, white_ne)
    others = tuple(claim for claim in claims if claim.method != method)
    squared = min(math.hypot(*white_ne) ** 2 / 2, math.dist(white_ne, before.white_ne) ** 2 / 4, MOST_SQUARED)
    suspicion = before.suspicion * math.exp(GAIN * (squared - 1))
    apart = apart if before.apart is None or apart is None else before.apart.then(apart, sigma_v_mps)
    return *others, Claim(method, min(max(suspicion, 1.0), CHANCE * MOST), white_ne, apart)


def _of(claims: tuple[Claim, ...], method: str) -> Claim | None:
    return next((claim for claim in claims if claim.method == method), None)
