"""A reference map that is a formula: its pixels and heights are known exactly at every place, heading and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visloc_companion.errors import OutsideMap
from visloc_companion.geo.raster import apply_affine, window_affine
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.types import FloatArray, GeoPoint, ReferencePatch

_N_WAVES = 24
_J_MAP_NE: FloatArray = np.array([[0.0, 1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class FlatProjection:
    """`protocols.LocalProjection` of a CRS without convergence and with scale 1."""

    origin_map_m: tuple[float, float]

    @property
    def J_map_ne(self) -> FloatArray:
        """(2, 2): (north, east) to (easting, northing)."""
        return _J_MAP_NE


class AnalyticMap:
    """A square of `2 half_size_m` about an origin; easting and northing are metres east and north of it.

    Grey values are a sum of plane waves of 4 to 80 m, different for each seed; the ground is a slope with a round hill.
    """

    def __init__(self, origin: GeoPoint, half_size_m: float = 500.0, gsd_m: float = 0.5, seed: int = 1) -> None:
        self.origin = origin
        self.half_size_m = half_size_m
        self._gsd_m = gsd_m
        rng = np.random.default_rng(seed)
        length_m = np.exp(rng.uniform(np.log(4.0), np.log(80.0), _N_WAVES))
        direction_rad = rng.uniform(0, 2 * np.pi, _N_WAVES)
        self._k_radpm = 2 * np.pi / length_m * np.array([np.cos(direction_rad), np.sin(direction_rad)])
        self._phase_rad = rng.uniform(0, 2 * np.pi, _N_WAVES)

    @property
    def gsd_m(self) -> float:
        """See protocols.ReferenceMap."""
        return self._gsd_m

    def grey(self, map_m: FloatArray) -> FloatArray:
        """(..., 2) easting, northing to the exact grey value (0 to 255, not rounded)."""
        waves = np.cos(map_m @ self._k_radpm + self._phase_rad).sum(axis=-1)
        return np.asarray(127.5 + 120.0 * np.tanh(waves / np.sqrt(_N_WAVES)))

    def heights_amsl_m(self, map_m: FloatArray) -> FloatArray:
        """(..., 2) easting, northing to surface height, metres; NaN outside the map."""
        hill = 20.0 * np.exp(-((map_m - np.array([60.0, -40.0])) ** 2).sum(axis=-1) / (2 * 50.0**2))
        heights = self.origin.h_amsl_m + 0.02 * map_m[..., 0] + hill
        return np.where(self._inside(map_m), heights, np.nan)

    def _inside(self, map_m: FloatArray) -> FloatArray:
        return np.asarray(np.abs(map_m).max(axis=-1) <= self.half_size_m)

    def patch(
        self, center_map_m: tuple[float, float], size_px: tuple[int, int], gsd_m: float, heading_rad: float
    ) -> ReferencePatch:
        """See protocols.ReferenceMap. Raises OutsideMap where no pixel is on the map."""
        T_map_pix = window_affine(center_map_m, size_px, _J_MAP_NE, gsd_m, heading_rad)
        u, v = np.meshgrid(np.arange(size_px[0], dtype=float), np.arange(size_px[1], dtype=float))
        map_m = apply_affine(T_map_pix, np.stack([u, v], axis=-1))
        valid = self._inside(map_m).astype(bool)
        if not valid.any():
            raise OutsideMap(f"no pixel of the window about {center_map_m} lies on the map", where="analytic map")
        pixels = np.where(valid, np.rint(self.grey(map_m)), 0).astype(np.uint8)
        return ReferencePatch(pixels, valid, self.heights_amsl_m(map_m).astype(np.float32), T_map_pix, gsd_m, heading_rad)

    def projection_at(self, place: GeoPoint) -> FlatProjection:
        """See protocols.ReferenceMap."""
        return FlatProjection(self.to_map(place.lat_deg, place.lon_deg))

    def to_map(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """See protocols.ReferenceMap."""
        north_m, east_m, _ = ned_from_geo(GeoPoint(lat_deg, lon_deg, 0.0), self.origin)
        return east_m, north_m

    def to_geo(self, easting_m: float, northing_m: float) -> tuple[float, float]:
        """See protocols.ReferenceMap."""
        place = geo_from_ned((northing_m, easting_m, 0.0), self.origin)
        return place.lat_deg, place.lon_deg

    def height_amsl_m(self, easting_m: float, northing_m: float) -> float:
        """See protocols.ReferenceMap."""
        return float(self.heights_amsl_m(np.array([easting_m, northing_m])))

    def covers(self, lat_deg: float, lon_deg: float, margin_m: float = 0.0) -> bool:
        """See protocols.ReferenceMap."""
        return max(map(abs, self.to_map(lat_deg, lon_deg))) <= self.half_size_m + margin_m
