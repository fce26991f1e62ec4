"""Wrong matches as ground makes them, for flights without pictures: where a method is wrong, and by how much, is a matter of the
ground that it looks at, so a vehicle that stays has the same answer again, right or wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter.lasting import BY_SHAPE
from visloc_companion.core.filter.votes import CORRELATION, spacing_m
from visloc_companion.types import FloatArray


def lasts_m(height_m: float) -> float:
    """The way after which half of the wrong matches from a height above the ground have come to an end."""
    return spacing_m(None, height_m)


def stays(method: str, way_m: float, half_m: float) -> float:
    """Probability that a method's answer is still of what it was of, so far on; shapes are seen over more than a frame."""
    return max(CORRELATION if method in BY_SHAPE else 0.0, 0.5 ** (way_m / half_m))


def anywhere_m(reach_m: float, rng: np.random.Generator) -> FloatArray:
    """(2,) from the middle of a search region to anywhere in it."""
    angle, distance = rng.uniform(0, 2 * math.pi), reach_m * math.sqrt(rng.random())
    return distance * np.array([math.cos(angle), math.sin(angle)])


@dataclass(slots=True)
class Match:
    """What a method makes of the ground in view: `wrong_by` (n,) metres, or None where it is right, or has not looked yet."""

    method: str
    wrong_by: FloatArray | None = None
    looked: bool = False

    def look(
        self, way_m: float, half_m: float, claim: float, rng: np.random.Generator, drawn: Callable[[], FloatArray]
    ) -> FloatArray | None:
        """By how much the next answer is wrong, so far on from the last: as it was, or, over other ground, as often as it claims
        by what is drawn."""
        if self.looked and rng.random() < stays(self.method, way_m, half_m):
            return self.wrong_by
        self.looked = True
        self.wrong_by = drawn() if rng.random() < claim else None
        return self.wrong_by
