"""How large a raster's pixel is on the ground."""

from __future__ import annotations

import numpy as np

from visloc_companion.errors import MapError, OutsideMap
from visloc_companion.maps.crs import MapCrs
from visloc_companion.types import FloatArray

POLAR_DEG = 89.999
"""Within 111 m of a pole a projection without a scale is no fault of its coordinates."""


def ground_gsd_m(crs: MapCrs, T_map_pix: FloatArray, shape: tuple[int, int], name: str = "") -> float:
    """Geometric mean of a pixel's sides on the ground, metres, at the centre of a raster of (rows, cols).

    Raises MapError, which names the raster, where the CRS has no scale there: at a pole, or off the earth.
    """
    centre = T_map_pix @ np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2, 1.0])
    try:
        J = crs.linearised_at_map(float(centre[0]), float(centre[1])).J_map_ne
    except OutsideMap as why:
        correct = "correct its coordinates or its CRS (gdalinfo FILE)"
        lat_deg = float(crs.to_geo_array(centre[None])[0, 0])
        if not abs(lat_deg) > POLAR_DEG:
            raise MapError(f"has its middle at no place: {why.what}", where=name, remedy=correct) from why
        what = f"has its middle at the {'north' if lat_deg > 0 else 'south'} pole, where no direction is north"
        cut = "cut it so that its middle lies 100 m or more beside the pole (gdal_translate -srcwin XOFF YOFF COLS ROWS FILE NEW)"
        raise MapError(what, where=name, remedy=f"{cut}; where it is of another place, {correct}") from why
    return float(np.sqrt(abs(np.linalg.det(T_map_pix[:, :2]) / np.linalg.det(J))))
