"""Where places lie in a layer."""

from __future__ import annotations

import numpy as np

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.layer import Layer
from visloc_companion.types import FloatArray


def pix_of_geo(layer: Layer, crs: MapCrs, lat_lon_deg: FloatArray) -> FloatArray:
    """(N, 2) pix of level 0 of a layer in `crs` at (N, 2) latitude, longitude (WGS 84); NaN where there is none.

    The longitudes of a raster in degrees may run beyond 180, across the antimeridian or from 0 to 360: places are looked for
    within half a turn of its middle.
    """
    places = crs.to_map_array(lat_lon_deg)
    if crs.is_geographic:
        places[:, 0] = near_middle(layer, crs, places[:, 0])
    return apply_affine(invert_affine(layer.T_map_pix), places)


def near_middle(layer: Layer, crs: MapCrs, lon: FloatArray) -> FloatArray:
    """Longitudes in the unit of a geographic CRS as the layer in it would have them: within half a turn of its middle."""
    rows, cols = layer.shapes[0]
    west = float(apply_affine(layer.T_map_pix, np.array([(cols - 1) / 2, (rows - 1) / 2]))[0]) - crs.turn / 2
    return np.asarray(lon - crs.turn * np.floor((lon - west) / crs.turn), dtype=np.float64)
