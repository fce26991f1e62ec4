"""A procedural landscape, deterministic by seed, on two dates years and seasons apart.

`map` is an early summer with leaves on; `flight` is a leafless early March five years later: bare trees, ploughed fields
divided anew, felled stands, new buildings, a low sun from the other side. Roads, most boundaries, hedges, houses, water and most
trees stay. `snow` is the flight's winter: the same things under snow.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.mapped.shadow import cast_shadow
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_ground import field_table, lasting_layers, paint_ground
from visloc_companion.sim.land.landscape_light import light_up
from visloc_companion.sim.land.landscape_noise import Raster, rng_of, smooth_noise
from visloc_companion.sim.land.landscape_objects import Trees, felled_parcels, place_buildings, plant_trees
from visloc_companion.sim.land.landscape_plan import make_plan
from visloc_companion.sim.land.landscape_snow import drifted, snowed
from visloc_companion.sim.land.landscape_stamps import Objects, stamp_objects
from visloc_companion.sim.land.landscape_terrain import terrain
from visloc_companion.sim.land.season import Date, Season, season_of
from visloc_companion.sim.scene import Scene
from visloc_companion.types import GeoPoint, Image

CRS = "EPSG:32632"
CENTER_MAP_M = (605_000.0, 5_349_000.0)
ROOFS = np.array([(158, 88, 66), (142, 78, 60), (120, 74, 62), (104, 100, 100), (134, 128, 122), (172, 104, 76)], np.float32)
POROUS_SHADE = 0.45
"""Share of the sunlight that a bare crown blocks."""


def build_landscape(seed: int, date: Date | Season, size_m: float = 2000.0, gsd_m: float = 0.5) -> Scene:
    """The scene of one date: a square of `size_m` about a fixed centre in UTM zone 32 north."""
    season = date if isinstance(date, Season) else season_of(date)
    grid, plan = Grid(round(size_m / gsd_m), gsd_m), make_plan(seed, size_m)
    lasting, trees = lasting_layers(grid, plan), plant_trees(seed, plan)
    table = field_table(seed, plan, season, felled_parcels(seed, plan))
    albedo, crop_m = paint_ground(seed, grid, plan, lasting, table, season)
    standing = trees.at_map if season.years == 0 else trees.at_flight
    objects = stamp_objects(grid, trees, place_buildings(seed, plan), standing, lasting.blocked, season)
    _paint_objects(albedo, objects, trees, season)
    ground_m = terrain(seed, grid, plan)
    if season.snow is not None:
        albedo = snowed(seed, albedo, objects, trees.conifer, season.snow, gsd_m)
        ground_m = drifted(seed, ground_m, season.snow, gsd_m)
    np.maximum(objects.height_m, crop_m, out=crop_m)
    surface_m = ground_m + crop_m
    photo = light_up(albedo, surface_m, _shade(ground_m, surface_m, objects, trees, grid, season), gsd_m, season)
    _clouds(photo, seed, gsd_m, season)
    left, top = CENTER_MAP_M[0] - size_m / 2, CENTER_MAP_M[1] + size_m / 2
    T_map_pix = np.array([[gsd_m, 0.0, left + gsd_m / 2], [0.0, -gsd_m, top - gsd_m / 2]])
    return Scene(photo, surface_m, T_map_pix, CRS)


def home(scene: Scene) -> GeoPoint:
    """A level, open place within 200 m of the scene's middle, at the surface's height."""
    width, height = scene.size_px
    gsd_m = float(np.hypot(*scene.T_map_pix[:, 0]))
    reach = int(min(200 / gsd_m, 0.2 * min(width, height)))
    c0, r0 = width // 2 - reach, height // 2 - reach
    window = scene.dsm_amsl_m[r0 : r0 + 2 * reach, c0 : c0 + 2 * reach]
    box = (2 * int(15 / gsd_m) + 1,) * 2
    deviation = cv2.blur(window * window, box) - cv2.blur(window, box) ** 2 if window.size else window
    row, column = np.unravel_index(int(np.argmin(deviation)), deviation.shape)
    easting, northing = scene.T_map_pix @ np.array([c0 + column, r0 + row, 1.0])
    lat, lon = map_crs(scene.crs).to_geo(float(easting), float(northing))
    return GeoPoint(lat, lon, float(window[row, column]))


def _bare(objects: Objects, trees: Trees, season: Season) -> NDArray[np.bool_]:
    """Where a crown without leaves stands."""
    if season.leaf_on:
        return np.zeros(objects.tree.shape, bool)
    return (objects.tree >= 0) & ~trees.conifer[np.maximum(objects.tree, 0)]


def _paint_objects(albedo: Image, objects: Objects, trees: Trees, season: Season) -> None:
    """Crowns and roofs over the ground, in place. Through a bare crown the ground is seen."""
    at = np.flatnonzero(objects.tree.ravel() >= 0)
    number = objects.tree.ravel()[at]
    deciduous, conifer = np.array(season.deciduous, np.float32), np.array(season.conifer, np.float32)
    tones = np.where(
        trees.conifer[:, None],
        conifer[(trees.tone * len(conifer)).astype(int)],
        deciduous[(trees.tone * len(deciduous)).astype(int)],
    )
    tones = (tones * (0.9 + 0.2 * np.mod(trees.tone * 7919, 1))[:, None]).astype(np.float32)
    alpha = np.where(trees.conifer, 1.0, season.bare_alpha).astype(np.float32)[number][:, None]
    flat = albedo.reshape(-1, 3)
    shade = (objects.shade.ravel()[at].astype(np.float32) / 128)[:, None]
    flat[at] = np.clip(tones[number] * shade * alpha + flat[at] * (1 - alpha), 0, 255)
    at = np.flatnonzero(objects.roof)
    tone = objects.roof.ravel()[at].astype(np.int64)
    flat[at] = ROOFS[tone % len(ROOFS)] * (0.85 + 0.3 * (tone[:, None] / 255)) * (1.0 if season.years == 0 else 0.95)


def _shade(ground_m: Raster, surface_m: Raster, objects: Objects, trees: Trees, grid: Grid, season: Season) -> Raster:
    """Share of the sunlight that is blocked at each pixel, by solid things and by bare crowns."""
    sun = (grid.gsd_m, season.sun_azimuth_deg, season.sun_elevation_deg)
    bare = _bare(objects, trees, season)
    if not bare.any():
        return np.asarray(np.clip(cast_shadow(surface_m, *sun) * np.float32(1 / 1.2), 0, 1), dtype=np.float32)
    solid = np.where(bare, ground_m, surface_m)
    by_solid = np.clip((cast_shadow(solid, *sun) - (surface_m - solid)) * np.float32(1 / 1.2), 0, 1)
    by_bare = np.clip(cast_shadow(surface_m, *sun) * np.float32(1 / 3.0), 0, 1)
    return np.asarray(np.maximum(by_solid, by_bare * np.float32(POROUS_SHADE)), dtype=np.float32)


def _clouds(photo: Image, seed: int, gsd_m: float, season: Season) -> None:
    """Uneven light over the photograph (thin cloud, flight strips), in place, by bands."""
    size = photo.shape[0]
    uneven = smooth_noise(rng_of(seed, f"clouds {season.years}"), size, 380 / gsd_m) * np.float32(0.05) + 1
    for top in range(0, size, 400):
        band = slice(top, top + 400)
        photo[band] = np.clip(photo[band] * uneven[band][:, :, None], 0, 255)
