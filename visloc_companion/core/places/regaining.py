"""A fix that would end a loss waits until others agree with it, over ground that the vehicle has moved on to.

What a fix claims to be wrong by was fitted on search regions of some hundred metres, most of them with the vehicle in it. After
minutes without fixes the region is as large as a tile of the map, the vehicle may be over ground that the map does not have, and
somewhere something looks like a frame. So the odds of core/places/place_search.py hold here as well: one answer finds nothing,
and two pictures of the same ground err alike. Every frame is searched for in the whole region meanwhile, so a place that is false
would have to be found again where the motion leads.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from visloc_companion.core.covariance import largest_sigma_m
from visloc_companion.core.filter.fusion import UNAIDED_SIGMA_MPS
from visloc_companion.core.places import hypotheses
from visloc_companion.core.places.hypotheses import FEWEST_HITS, GATE_SIGMA, Hypothesis
from visloc_companion.core.places.place_search import spacing_m, tile_radius_m
from visloc_companion.core.places.travel import TravelLog
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint, NavState, Vec2

FEW, SEVERAL = 2, 3
"""So many fixes end a loss where three sigma are less than half of the region of one search, and less than all of it."""
FORGET_NS = 20_000_000_000


class Regaining:
    """The places that fixes named since the loss, metres north and east of one origin, each with how many agree on it."""

    def __init__(self, travel: TravelLog) -> None:
        """`travel`: how far the vehicle came, by the velocity that the filter knows and by odometry; others keep it."""
        self._travel = travel
        self._n_born = 0
        self._origin: GeoPoint | None = None
        self.clear()

    def clear(self) -> None:
        """The loss is over, or nobody knows how far the vehicle went: nothing waits any more."""
        self._places: tuple[Hypothesis, ...] = ()
        self._found: int | None = None

    @property
    def waiting(self) -> bool:
        """Whether a fix waits."""
        return bool(self._places)

    def waits(self, fix: Fix, state: NavState, origin: GeoPoint, max_radius_m: float) -> bool:
        """Whether a fix waits for others, given the filter's state at its time; `max_radius_m`: of a search."""
        if not wgs84.same_spot(origin, self._origin):
            self.clear()
            self._origin = origin
        height_m = -state.p_ned_m[2]
        north, east, _ = wgs84.ned_from_geo(fix.place, origin)
        places = [self._travel.carried(h, fix.t_ns) for h in self._places if fix.t_ns - (h.tested_ns or 0) <= FORGET_NS]
        agreeing = [h for h in places if _agrees(h, fix, (north, east))]
        if agreeing:
            best = max(agreeing, key=lambda h: h.hits)
            now = hypotheses.confirmed(best, (north, east), fix.cov_ne_m2, spacing_m(fix, height_m))
        else:
            best, now = None, self._named(fix, (north, east), state)
        others = [h for h in places if h is not best]
        self._places = (*others, now)
        needed = hits_needed(largest_sigma_m(state.cov_ne_m2), tile_radius_m(height_m, max_radius_m))
        if now.hits >= needed and all(h.hits < now.hits for h in others):
            self._found = now.number  # a filter that refuses it, or follows half way, hears the next ones, too
        return now.number != self._found

    def _named(self, fix: Fix, place_ne_m: Vec2, state: NavState) -> Hypothesis:
        self._n_born += 1
        sigma_v_mps = UNAIDED_SIGMA_MPS if state.cov_v_ne_m2ps2 is None else largest_sigma_m(state.cov_v_ne_m2ps2)
        h = hypotheses.born(self._n_born, fix.t_ns, place_ne_m, largest_sigma_m(fix.cov_ne_m2), sigma_v_mps)
        return replace(h, hits=1, counted_ne_m=place_ne_m, tested_ns=fix.t_ns)


def hits_needed(sigma_m: float, tile_radius_m: float) -> int:
    """How many fixes have to agree before one is taken, for the filter's largest 1-sigma and the region of one search."""
    if 3 * sigma_m <= tile_radius_m / 2:
        return FEW
    return SEVERAL if 3 * sigma_m <= tile_radius_m else FEWEST_HITS


def _agrees(h: Hypothesis, fix: Fix, place_ne_m: Vec2) -> bool:
    """Whether a fix lies where the motion leads."""
    S = np.array(h.cov_ne_m2) + np.array(fix.cov_ne_m2)
    d = np.array(place_ne_m) - np.array(h.place_ne_m)
    return float(d @ np.linalg.solve(S, d)) <= GATE_SIGMA**2
