"""How far about its prior the search of an image case may go."""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.maps.grid import GridMap
from visloc_companion.types import GeoPoint

LEAST_M = LocaliserSettings().max_search_radius_m
"""What a flight searches at most: a camera that looks ahead may hang so far beside a small map."""
MOST_M = 15_000.0
"""From the middle of a map of 20 x 20 km to its corners; what memory and time have been measured for."""

MOST_POSITIONS = 2_000_000
"""Eight times a flight's: over a landscape of 5 m a pixel 6 instead of 4 of 6 frames are placed from ±2.6 km, in 2 s each."""


def search_reach_m(place: GeoPoint, reference: GridMap) -> float:
    """Metres from a prior's place to the map's farthest corner, LEAST_M to MOST_M.

    A flight bounds its search by what a frame's time allows; a case is to be searched for wherever its prior, three sigmas
    wide, says that it may be. Raises OutsideMap where the map's CRS has no coordinates for the place.
    """
    here = reference.projection_at(place)
    offsets_ne_m = np.linalg.solve(here.J_map_ne, (reference.corners_map_m - np.array(here.origin_map_m)).T)
    return float(np.clip(np.hypot(*offsets_ne_m).max(), LEAST_M, MOST_M))
