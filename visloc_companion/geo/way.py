"""Points along a way that is told by its places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from visloc_companion.geo.wgs84 import distance_m, geo_from_ned, ned_from_geo
from visloc_companion.types import GeoPoint


def along(places: Sequence[GeoPoint], step_m: float, most_steps: int | None = None) -> list[GeoPoint]:
    """The way's places and points between them, at the height of the place before, at most `step_m` apart; no more than
    `most_steps` of a leg, however long it is, where that is said."""
    points = list(places[:1])
    for start, end in pairwise(places):
        n = max(1, math.ceil(distance_m(end, start) / step_m))
        n = n if most_steps is None else min(n, most_steps)
        north, east, _ = ned_from_geo(end, start)
        points += [geo_from_ned((north * k / n, east * k / n, 0.0), start) for k in range(1, n)]
        points.append(end)
    return points
