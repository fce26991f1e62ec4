"""Where places lie in a layer."""

from __future__ import annotations

import numpy as np

from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.maps.crs import MapCrs
from visloc_companion.maps.layer import Layer
from visloc_companion.types import FloatArray


def pix_of_geo(layer: Layer, crs: MapCrs, lat_lon_deg: FloatArray) -> FloatArray:
    """(N, 2) pix of level 0 of a layer in `crs` at (N, 2) latitude, longitude (WGS 84); NaN where there is none.

    The eastings of a raster in degrees or Web Mercator may run beyond 180 degrees, across the antimeridian or from 0 to 360:
    places are looked for within half a turn of its middle.
    """
    places = crs.to_map_array(lat_lon_deg)
    if (turn := crs.turn) is not None:
        places[:, 0] = near_middle(layer, turn, places[:, 0])
    return apply_affine(invert_affine(layer.T_map_pix), places)


def middle_of(layer: Layer) -> tuple[float, float]:
    """Easting and northing (map units) of a layer's middle."""
    rows, cols = layer.shapes[0]
    easting, northing = apply_affine(layer.T_map_pix, np.array([(cols - 1) / 2, (rows - 1) / 2]))
    return float(easting), float(northing)


def near_middle(layer: Layer, turn: float, eastings: FloatArray) -> FloatArray:
    """Eastings as the layer would have them: within half a turn (map units) of its middle."""
    west = middle_of(layer)[0] - turn / 2
    return np.asarray(eastings - turn * np.floor((eastings - west) / turn), dtype=np.float64)
