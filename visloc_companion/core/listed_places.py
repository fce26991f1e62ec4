"""Which places the search of a tile leaves open, right or not."""

from __future__ import annotations

import math

from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NoFix, Vec2

LISTED, LEAST_MASS, LIKELY_MASS = 4, 0.02, 0.5
"""Of the modes that a search lists so many become hypotheses, unless its posterior has them less likely than the second; in the
first sweep and every other one, the third."""


def places_of(answer: Fix | NoFix, centre_ne_m: Vec2, origin: GeoPoint, apart_m: float, least: float) -> list[Vec2]:
    """The fix, and the modes of the search (localise/modes.py) of at least a probability that lie apart from it, metres north and
    east of the origin."""
    found: list[Vec2] = []
    if isinstance(answer, Fix):
        north, east, _ = wgs84.ned_from_geo(answer.place, origin)
        found.append((north, east))
    told = dict(answer.evidence)
    for k in range(1, LISTED + 1):
        if f"mode{k}_north_m" not in told or told.get(f"mode{k}_probability", 1.0) < least:
            break
        place = (centre_ne_m[0] + told[f"mode{k}_north_m"], centre_ne_m[1] + told[f"mode{k}_east_m"])
        if all(math.dist(place, other) >= apart_m for other in found):
            found.append(place)
    return found
