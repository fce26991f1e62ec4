"""How far a flight may go about the middle of a map, and how its course lies where the map is turned against true north."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo.raster import sides_turn_rad, square_reach_m, window_affine
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.maps.crs import Linearisation
from visloc_companion.maps.pack import PackMap
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightArea
from visloc_companion.types import FloatArray, GeoPoint

TURNED_RAD = math.radians(5.0)
SHIFTED = 0.5
"""Share of a strip's width by which its turn may move its ends aside; beyond, it is turned, however little."""
HELD, CELLS = 0.95, 64
"""Share of the square about home that the map has to show, as looked at in so many cells a side."""


def flight_area(reference: PackMap, scene: Scene, home: GeoPoint) -> FlightArea:
    """What map and scene both hold about a home on them. Raises OutsideMap where a CRS has no coordinates for it.

    The course's axes are north and east unless the map, or else the scene, is turned by more than `TURNED_RAD` or, a strip, by
    so much that its ends lie beside its middle (`SHIFTED`): then they are its sides. A survey that is no rectangle, with nothing
    about it in its own, reaches as far as a square of it is full (`HELD`).
    """
    rows, cols = reference.shape
    map_here, scene_here = reference.projection_at(home), scene.projection_at(home)
    rasters = (
        (reference.T_map_pix, (cols, rows), map_here.J_map_ne, np.array(map_here.origin_map_m)),
        (scene.T_map_pix, scene.size_px, scene_here.J_map_ne, np.array(scene_here.origin_map_m)),
    )
    turns_rad = [_turn_rad(T_map_pix, size_px, J_map_ne) for T_map_pix, size_px, J_map_ne, _ in rasters]
    turn_rad = next((turn for turn in turns_rad if turn != 0.0), 0.0)
    if turn_rad == 0.0:
        reach_m = min(corners_reach_m(reference, home), scene.reach_m(home))
    else:
        reach_m = min(square_reach_m(*raster, turn_rad) for raster in rasters)
    return FlightArea(home, _held_reach_m(reference, map_here, reach_m, turn_rad), reference.gsd_m, turn_rad)


def corners_reach_m(reference: PackMap, home: GeoPoint) -> float:
    """How far, metres, the corners of a map that is hardly turned lie from a home in its middle, to the north or the east."""
    rows, cols = reference.shape
    corners = np.array([[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]], dtype=np.float64)
    T = reference.T_map_pix
    map_m = corners @ T[:, :2].T + T[:, 2]
    places = [GeoPoint(*reference.to_geo(float(e), float(n)), home.h_amsl_m) for e, n in map_m]
    north_m = min(abs(distance_m(GeoPoint(p.lat_deg, home.lon_deg, 0.0), home)) for p in places)
    east_m = min(abs(distance_m(GeoPoint(home.lat_deg, p.lon_deg, 0.0), home)) for p in places)
    return min(north_m, east_m)


def _held_reach_m(reference: PackMap, here: Linearisation, reach_m: float, turn_rad: float) -> float:
    """`reach_m`, or so much of it that the map shows."""
    cell_m, half = 2 * reach_m / CELLS, CELLS // 2
    if cell_m <= 0.0:
        return reach_m
    T_map_cell = window_affine(here.origin_map_m, (CELLS, CELLS), here.J_map_ne, cell_m, turn_rad)
    shown = reference.share_valid(T_map_cell, (CELLS, CELLS))
    full = (k for k in range(half, 0, -1) if shown[half - k : half + k, half - k : half + k].mean() >= HELD)
    return reach_m * next(full, 0) / half


def _turn_rad(T_map_pix: FloatArray, size_px: tuple[int, int], J_map_ne: FloatArray) -> float:
    """How far a raster is turned, zero where that is little."""
    turn_rad = sides_turn_rad(T_map_pix, J_map_ne)
    shifted = math.tan(abs(turn_rad)) * max(size_px) / min(size_px)
    return turn_rad if abs(turn_rad) >= TURNED_RAD or shifted > SHIFTED else 0.0
