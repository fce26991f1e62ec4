"""What a localiser is told at construction, beside the camera model."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from visloc_companion.localise.mapped.map_light import MapLight


class Looks(Enum):
    """Which looks at a frame's candidates decide (looks.py): the second one only where the first declines, or one alone, which is
    how each is calibrated."""

    BOTH = "both"
    FIRST = "first"
    SECOND = "second"


MOST_POSITIONS = 250_000
"""Of a flight's search: 500,000 found no more places on tiles of 2.9 km² and took a fifth longer."""


@dataclass(frozen=True, slots=True)
class LocaliserSettings:
    """Limits and the map's own error.

    `max_probability_wrong`: fixes with a larger calibrated probability of being wrong are declined.
    `max_search_radius_m`: the search region never grows beyond this. `most_positions`: where the map within it would have more
    pixels, it is searched more coarsely. `map_sigma_m`: 1-sigma of the map's registration, added to the claimed covariance.
    `min_height_m`: below this height above the surface nothing is tried. `threads` search together; no answer depends on their
    number. `looks`: of localisers that look twice. `light`: what they share with others about the map's light; else their own.
    """

    max_probability_wrong: float = 0.05
    max_search_radius_m: float = 2000.0
    most_positions: int = MOST_POSITIONS
    map_sigma_m: float = 0.0
    min_height_m: float = 8.0
    threads: int = 1
    looks: Looks = Looks.BOTH
    light: MapLight | None = None
