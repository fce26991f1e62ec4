"""A reference map of hills that is a formula: what terrain navigation is tested over."""

from __future__ import annotations

import numpy as np

from visloc_companion.testing.fake_map import AnalyticMap
from visloc_companion.types import FloatArray, GeoPoint

_N_WAVES = 30


class HillyMap(AnalyticMap):
    """An AnalyticMap whose ground is a sum of waves of 300 to 3000 m with a 1-sigma height of `height_m` about the origin's."""

    def __init__(self, origin: GeoPoint, half_size_m: float, height_m: float, gsd_m: float = 10.0, seed: int = 1) -> None:
        super().__init__(origin, half_size_m, gsd_m, seed)
        rng = np.random.default_rng([seed, 7])
        length_m = np.exp(rng.uniform(np.log(300.0), np.log(3000.0), _N_WAVES))
        direction_rad = rng.uniform(0, 2 * np.pi, _N_WAVES)
        self._k_hills_radpm = 2 * np.pi / length_m * np.array([np.cos(direction_rad), np.sin(direction_rad)])
        self._phase_hills_rad = rng.uniform(0, 2 * np.pi, _N_WAVES)
        self._weight_m = height_m * np.sqrt(2 / _N_WAVES) * length_m / np.sqrt(np.square(length_m).mean())

    def heights_amsl_m(self, map_m: FloatArray) -> FloatArray:
        """(..., 2) easting, northing to surface height, metres; NaN outside the map."""
        waves = np.sin(map_m @ self._k_hills_radpm + self._phase_hills_rad) @ self._weight_m
        return np.where(self._inside(map_m), self.origin.h_amsl_m + waves, np.nan)
