"""Stereo's simulated truth: overlapping frames over the procedural landscape, poses as an autopilot has them, and land cover."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.geo.camera import R_FRD_CAM, project
from visloc_companion.geo.raster import apply_affine, invert_affine
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.structure.base import PosedFrame
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_ground import lasting_layers
from visloc_companion.sim.land.landscape_objects import place_buildings, plant_trees
from visloc_companion.sim.land.landscape_plan import Line, Use, make_plan
from visloc_companion.sim.land.landscape_stamps import stamp_objects
from visloc_companion.sim.land.season import Date, season_of
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, FloatArray, GeoPoint

MODEL = CameraModel(640, 480, 425.5, 425.5, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0))
"""73.9° across, 58.9° along the flight."""
HEIGHT_M = 90.0
SIGMA_ATTITUDE_RAD = math.radians(0.5)
SIGMA_BASELINE_M = 0.3
SIGMA_TILT_FLOWN_RAD = math.radians(3.0)
COVERS = ("trees", "buildings", "roads", "fields", "gardens", "water", "gaps in forests")
ENU_NED: FloatArray = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A scene of one date and the number in COVERS of each of its pixels."""

    scene: Scene
    cover: NDArray[np.uint8]
    date: str


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Frames with disturbed poses, the true ones (F, 4, 4), and how `local` lies on the scene: `A_pix_en` (2, 3)."""

    world: World
    frames: list[PosedFrame]
    T_local_cam: FloatArray
    A_pix_en: FloatArray
    overlap: float

    def truth_at(self, points_en: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
        """Surface height (bilinear) and cover at (N, 2) east, north."""
        scene = self.world.scene
        return _looked_up(scene.dsm_amsl_m, self.A_pix_en, points_en), self._nearest(self.world.cover, points_en)

    def slope_at(self, points_en: FloatArray, axis: int) -> FloatArray:
        """Slope (N,) of the surface, smoothed over half a metre, towards east (axis 0) or north (1)."""
        step = np.eye(2)[axis] * 0.5
        ahead, behind = (_looked_up(self.world.scene.dsm_amsl_m, self.A_pix_en, points_en + s * step) for s in (1, -1))
        return np.nan_to_num(np.clip(ahead - behind, -3, 3))

    def _nearest(self, layer: NDArray[Any], points_en: FloatArray) -> NDArray[Any]:
        u, v = np.round(apply_affine(self.A_pix_en, points_en)).astype(int).T
        return np.asarray(layer[v.clip(0, layer.shape[0] - 1), u.clip(0, layer.shape[1] - 1)])

    def roughness_at(self, points_en: FloatArray) -> FloatArray:
        """Metres (N,) by which the surface stands off its mean over 1.25 m (no less than 3 pixels)."""
        scene = self.world.scene
        side = max(3, round(1.25 / float(np.hypot(*scene.T_map_pix[:, 0]))) // 2 * 2 + 1)
        off = np.abs(scene.dsm_amsl_m - cv2.blur(scene.dsm_amsl_m, (side, side)))
        return self._nearest(off, points_en)

    def seen_twice(self, cells_en: FloatArray) -> NDArray[np.bool_]:
        """Which places on the surface lie within two frames or more. What hides them is not asked."""
        up, _ = self.truth_at(cells_en)
        points = np.column_stack([cells_en, up])
        size = np.array([MODEL.width_px - 1, MODEL.height_px - 1])
        count = np.zeros(len(points), int)
        for T in self.T_local_cam:
            q = (points - T[:3, 3]) @ T[:3, :3]
            near = (np.abs(q[:, :2]) < 0.9 * q[:, 2:3]).all(1)
            pix = project(MODEL, q)
            with np.errstate(invalid="ignore"):
                count += near & (pix >= 0).all(1) & (pix <= size).all(1)
        return np.asarray(count >= 2, dtype=np.bool_)


def _looked_up(layer: NDArray[np.float32], A_pix_en: FloatArray, points_en: FloatArray) -> FloatArray:
    """(N,) bilinear values, NaN outside."""
    n, row = len(points_en), 8192  # remap takes no row of 32767 and more
    pix = np.full((-(-n // row) * row, 2), -9.0, np.float32)
    pix[:n] = apply_affine(A_pix_en, points_en)
    u, v = (np.ascontiguousarray(pix[:, k].reshape(-1, row)) for k in (0, 1))
    values = cv2.remap(layer, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan)
    return np.asarray(values, dtype=np.float64).ravel()[:n]


def landscape(seed: int, date: Date, size_m: float, gsd_m: float) -> World:
    """The procedural landscape of a date with its cover."""
    grid, plan, season = Grid(round(size_m / gsd_m), gsd_m), make_plan(seed, size_m), season_of(date)
    lasting, trees = lasting_layers(grid, plan), plant_trees(seed, plan)
    standing = trees.at_map if season.years == 0 else trees.at_flight
    objects = stamp_objects(grid, trees, place_buildings(seed, plan), standing, lasting.blocked, season)
    use = np.array([parcel.use for parcel in plan.parcels])[lasting.parcel]
    cover = np.select([use == Use.FOREST, use == Use.VILLAGE], [6, 4], 3).astype(np.uint8)
    for line in (Line.MAIN, Line.MINOR, Line.TRACK):
        cover[lasting.lines[line] > 128] = 2
    cover[lasting.water > 128] = 5
    cover[objects.tree >= 0] = 0
    cover[objects.roof > 0] = 1
    return World(build_landscape(seed, date, size_m, gsd_m), cover, str(date))


def box_world(gsd_m: float) -> World:
    """Level textured ground with two blocks of 12 and 20 m: what renderer and stereo make of a known height."""
    size = round(400 / gsd_m)
    rng = np.random.default_rng(5)
    grey = sum(
        s * (n := cv2.GaussianBlur(rng.standard_normal((size, size)).astype(np.float32), (0, 0), w / gsd_m)) / n.std()
        for s, w in ((22, 0.3), (22, 1.0), (25, 4.0))
    )
    pixels = np.repeat(np.clip(grey + 110, 0, 255).astype(np.uint8)[:, :, None], 3, 2)
    dsm, cover = np.full((size, size), 300, np.float32), np.full((size, size), 3, np.uint8)
    for east, north, half_e, half_n, height in ((-4.0, 1.0, 10.0, 11.0, 12.0), (27.0, -15.0, 5.0, 10.0, 20.0)):
        c0, c1, r0, r1 = (round((200 + x) / gsd_m) for x in (east - half_e, east + half_e, -north - half_n, -north + half_n))
        dsm[r0:r1, c0:c1] += height
        cover[r0:r1, c0:c1] = 1
    T = np.array([[gsd_m, 0.0, 605_000 - 200 + gsd_m / 2], [0.0, -gsd_m, 5_349_000 + 200 - gsd_m / 2]])
    return World(Scene(pixels, dsm, T, "EPSG:32632"), cover, "box")


def fly(world: World, rng: np.random.Generator, overlap: float, n: int = 3, at: tuple[float, float] | None = None) -> Flight:
    """`n` frames in a line with so much overlap of neighbours, HEIGHT_M above the median surface; `at` as shares of the scene."""
    scene = world.scene
    width, height = scene.size_px
    share = np.array(at) if at else rng.uniform(0.22, 0.78, 2)
    pix = share * [width - 1, height - 1]
    half = round(60 / float(np.hypot(*scene.T_map_pix[:, 0])))
    around = scene.dsm_amsl_m[int(pix[1]) - half : int(pix[1]) + half, int(pix[0]) - half : int(pix[0]) + half]
    up = float(np.median(around)) + HEIGHT_M
    crs = map_crs(scene.crs)
    local = crs.linearised_at_map(*apply_affine(scene.T_map_pix, pix))
    origin = GeoPoint(*crs.to_geo(*local.origin_map_m), 0.0)
    to_pix = invert_affine(scene.T_map_pix)
    A_pix_en = np.column_stack([to_pix[:, :2] @ local.J_map_ne[:, ::-1], pix])
    heading = float(rng.uniform(-math.pi, math.pi))
    step = (1 - overlap) * HEIGHT_M * MODEL.height_px / MODEL.fy_px
    simulator = CameraSimulator(scene, MODEL, CameraEffects())
    frames, truth = [], np.tile(np.eye(4), (n, 1, 1))
    for k in range(n):
        along = step * (k - (n - 1) / 2)
        north, east = along * math.cos(heading), along * math.sin(heading)
        euler = (*rng.normal(0, SIGMA_TILT_FLOWN_RAD, 2), heading + rng.normal(0, 0.05))
        q = quat_from_euler(*(float(a) for a in euler))
        place = replace(geo_from_ned((north, east, 0.0), origin), h_amsl_m=up)
        pixels = simulator.frame(place, q, int(rng.integers(2**31)))
        truth[k, :3, :3], truth[k, :3, 3] = ENU_NED @ R_from_quat(q) @ R_FRD_CAM, (east, north, up)
        T = truth[k].copy()
        T[:3, :3] = cv2.Rodrigues(rng.normal(0, SIGMA_ATTITUDE_RAD, 3))[0] @ T[:3, :3]
        T[:3, 3] += rng.normal(0, SIGMA_BASELINE_M / math.sqrt(2), 3)
        sigma = SIGMA_BASELINE_M / math.sqrt(2), SIGMA_ATTITUDE_RAD, SIGMA_ATTITUDE_RAD
        frames.append(PosedFrame(pixels, T, *sigma, height_m=HEIGHT_M))
    return Flight(world, frames, truth, A_pix_en, overlap)


def ranged(flight: Flight, rng: np.random.Generator, sigma_m: float) -> list[PosedFrame]:
    """The frames with a rangefinder's height above what is straight below."""
    out = []
    for frame, T in zip(flight.frames, flight.T_local_cam, strict=True):
        below = float(flight.truth_at(T[None, :2, 3])[0][0])
        out.append(replace(frame, height_m=T[2, 3] - below + rng.normal(0, sigma_m), sigma_height_m=sigma_m))
    return out
