"""Local coordinates about a place: metres north and east, and the map's CRS linearised there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import FloatArray, GeoPoint


@dataclass(frozen=True, slots=True, eq=False)
class LocalFrame:
    """Metres north and east of a place, and the map's CRS linearised there."""

    origin: GeoPoint
    J_map_ne: FloatArray
    origin_map: FloatArray

    @property
    def map_units_per_m(self) -> float:
        """How long a metre on the ground is in the map's CRS."""
        return math.sqrt(abs(float(np.linalg.det(self.J_map_ne))))

    def A_ne_pix(self, T_map_pix: FloatArray) -> FloatArray:
        """(2, 3) pix -> metres north, east, for a window of the map."""
        inverse = np.linalg.inv(self.J_map_ne)
        return np.column_stack([inverse @ T_map_pix[:, :2], inverse @ (T_map_pix[:, 2] - self.origin_map)])

    def to_map(self, ne_m: FloatArray) -> tuple[float, float]:
        """Map coordinates of a place given in metres north, east."""
        x, y = self.origin_map + self.J_map_ne @ ne_m
        return float(x), float(y)


def local_frame(place: GeoPoint, ref: ReferenceMap) -> LocalFrame:
    """Local coordinates about a place, zero height at sea level. Raises OutsideMap where the map's CRS has none."""
    projection = ref.projection_at(place)
    return LocalFrame(
        GeoPoint(place.lat_deg, place.lon_deg, 0.0),
        np.asarray(projection.J_map_ne),
        np.array(projection.origin_map_m, dtype=np.float64),
    )
