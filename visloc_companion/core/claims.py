"""By how much fixes of a method err more than they claim, learned from how they scatter about the filter.

Innovations made white by their covariance have variance 1 on each axis while all claims hold, and differences of two in a row
have twice that. Where both are larger, what the method claims is raised until one is not (stochastic approximation: Robbins and
Monro, 1951). Innovations alone are as large where a velocity is held wrong, which has all of them to one side and is no fix's
fault; differences alone are as large where neighbouring fixes have less in common than they are taken to. Claims are never
lowered, and those that hold are left exactly as they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from visloc_companion.types import Vec2

GAIN = 0.05
"""Of the suspicion's logarithm, for each fix: a hundred fixes or so learn a factor of 25, and as many forget it."""
CHANCE = 1.5
"""Suspicion up to this is what honest fixes come to by chance."""
MOST = 100.0
MOST_SQUARED = 8.0
"""No fix counts for more: one that is wrong says nothing of the others."""


@dataclass(frozen=True, slots=True)
class Claim:
    """Of a method: how far its claims are suspected, at least 1, and the whitened innovation of its last fix that was taken."""

    method: str
    suspicion: float
    white_ne: Vec2

    @property
    def over(self) -> float:
        """By what factor the variance of its fixes is larger than they claim, at least 1."""
        return max(1.0, self.suspicion / CHANCE)


def over(claims: tuple[Claim, ...], method: str) -> float:
    """The factor of a method's variance."""
    return next((claim.over for claim in claims if claim.method == method), 1.0)


def learned(claims: tuple[Claim, ...], method: str, white_ne: Vec2) -> tuple[Claim, ...]:
    """After a fix that the filter took, with its innovation made white by what it was taken to err by."""
    before = next((claim for claim in claims if claim.method == method), Claim(method, 1.0, white_ne))
    others = tuple(claim for claim in claims if claim.method != method)
    squared = min(math.hypot(*white_ne) ** 2 / 2, math.dist(white_ne, before.white_ne) ** 2 / 4, MOST_SQUARED)
    suspicion = before.suspicion * math.exp(GAIN * (squared - 1))
    return *others, Claim(method, min(max(suspicion, 1.0), CHANCE * MOST), white_ne)
