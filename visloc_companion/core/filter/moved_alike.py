"""What moves all fixes alike, and so shows in none of them: the map's registration, a lens that bends the picture, a camera that
looks beside where it should. The last two grow with the height that is flown."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MovedAlike:
    """1-sigma of the map's registration, on each axis; how much the lens may bend pictures otherwise than configured
    (distortion_watch.DistortionWatch.bend); by how much of the height the camera may look beside, of which `aim_open` is not
    taken off (aim.Aim)."""

    map_sigma_m: float
    lens_bend: float = 0.0
    aim_share: float = 0.0
    aim_open: float = 0.0

    def sigma_m(self, flown_m: float) -> float:
        """1-sigma of what is common to all fixes, on each axis, `flown_m` from home's height.

        What is taken off is in it all the same: nobody can say whether it was the camera's, or a false GNSS's.
        """
        return math.hypot(max(self.map_sigma_m, self.aim_share / 2 * flown_m), self._bent_m(flown_m))

    def astray_m(self, flown_m: float) -> float:
        """1-sigma, on each axis, of what fixes are off by beside GNSS, for a lens that bends the picture or a camera that looks
        elsewhere: half of what moves them, as of a map."""
        return math.hypot(self._bent_m(flown_m), self.aim_open / 2 * flown_m)

    def _bent_m(self, flown_m: float) -> float:
        """Half of what a height of way makes of the bend, which is taken for a tilt."""
        return self.lens_bend / 2 * flown_m
