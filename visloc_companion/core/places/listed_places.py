"""Which places the search of a tile leaves open, right or not."""

from __future__ import annotations

import math

from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NoFix, Vec2

LISTED = 4
LIKELY, THOROUGH = 0.5, 0.2
"""Of the places that an answer leaves open so many become hypotheses, unless it has them less likely than the second; in thorough
sweeps, the third. To test one takes as long as to search another tile. In flights over a landscape not trained on three of 163
open places of 0.2 and more were the vehicle's (quick sweeps), and none of 96 of 0.05 and more (thorough ones), while 30 of 561
tiles showed it, 26 of them by a fix."""


def places_of(answer: Fix | NoFix, origin: GeoPoint, least: float) -> list[Vec2]:
    """The fix, or the open places of at least a probability, likeliest first, metres north and east of the origin."""
    if isinstance(answer, Fix):
        return [_ne_m(answer.place, origin)]
    likely = [each for each in answer.open_places if each.log_evidence >= math.log(least)]
    return [_ne_m(each.place, origin) for each in likely[:LISTED]]


def _ne_m(place: GeoPoint, origin: GeoPoint) -> Vec2:
    north, east, _ = wgs84.ned_from_geo(place, origin)
    return north, east
