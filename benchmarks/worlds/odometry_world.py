"""Odometry's simulated truth: flights over the procedural landscape, frames rendered once and kept, and what an autopilot knows.

Pictures are of one date, the surface model of the other (years apart, 1 m). Copters fly at 10 m/s 60 to 120 m above the ground,
planes at 25 m/s 150 to 300 m above it with a turn of up to 45 degrees of bank in the middle; 3 frames a second, the camera
fixed to the body. `hover` stays where it is, `leaning` is a copter against its drag: 9 m/s at 28 to 42 degrees, 45 to 75 m up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.geo.raster import apply_affine, compose_affine, invert_affine
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.localise.odometry.base import Sight, Surface
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, FloatArray, GeoPoint, Image

MODEL = CameraModel(640, 480, 425.5, 425.5, 319.5, 239.5, (-0.05, 0.01, 0.0, 0.0, 0.0))
PERIOD_S = 1 / 3
FRAMES = 60
VEHICLES = ("copter", "hover", "plane", "leaning")
"""Their order goes into what is drawn: another one is added at the end."""
SIZE_M = {"copter": (800.0, 0.25), "hover": (800.0, 0.25), "plane": (1800.0, 0.5), "leaning": (1100.0, 0.25)}
EDGE_M = {"copter": 140.0, "hover": 200.0, "plane": 350.0, "leaning": 260.0}
SPEED_MPS = {"copter": 10.0, "hover": 0.0, "plane": 25.0, "leaning": 9.0}
HEIGHT_M = {"copter": (60.0, 120.0), "hover": (60.0, 120.0), "plane": (150.0, 300.0), "leaning": (45.0, 75.0)}
LEAN_RAD = {"copter": math.radians(8.0), "leaning": math.radians(35.0)}
LEAN_VARIES_RAD = {"leaning": math.radians(7.0)}
G_MPS2 = 9.81


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Frames (F, H, W) grey, the true path (F, 3) north, east, down (down from the sea), attitudes (F, 3) roll, pitch, yaw, true
    heights above the surface straight below (F,), and the surface model of the other date."""

    name: str
    vehicle: str
    frames: Image
    p_ned_m: FloatArray
    euler_rad: FloatArray
    height_m: FloatArray
    surface: Surface

    @property
    def distance_m(self) -> float:
        """Length of the horizontal path."""
        return float(np.hypot(*np.diff(self.p_ned_m[:, :2], axis=0).T).sum())


@dataclass(frozen=True, slots=True)
class Errors:
    """1-sigma of what the autopilot gets wrong: tilt and heading (constant, and of each frame), altitude against the map
    (constant) and from frame to frame, the place on the map, a rangefinder (constant share and noise); and by which share the
    calibrated focal length is off."""

    tilt_rad: float = math.radians(0.5)
    yaw_rad: float = math.radians(1.0)
    turn_rad: float = math.radians(0.15)
    up_m: float = 1.0
    climb_m: float = 0.15
    place_m: float = 3.0
    range_m: float = 0.3
    home_m: float = 8.0
    lens: float = 0.015


def path_of(vehicle: str, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """(F, 2) north, east about the start and (F, 3) roll, pitch, yaw."""
    t = np.arange(FRAMES) * PERIOD_S
    speed = SPEED_MPS[vehicle]
    wobble = np.column_stack([_waves(t, rng, math.radians(a)) for a in (2.5, 2.0, 1.5)])
    if vehicle == "plane":
        bank = math.radians(rng.uniform(25, 42)) * rng.choice([-1, 1]) * np.exp(-(((t - t.mean()) / 3.0) ** 4))
        turn = G_MPS2 * np.tan(bank) / speed
    else:
        bank = np.zeros(len(t))
        turn = np.full(len(t), math.radians(rng.uniform(-4, 4)))
    yaw = rng.uniform(-math.pi, math.pi) + np.cumsum(turn) * PERIOD_S
    v = speed * np.column_stack([np.cos(yaw), np.sin(yaw)])
    p = np.cumsum(v, axis=0) * PERIOD_S
    if vehicle == "hover":
        p = np.column_stack([_waves(t, rng, 0.8), _waves(t, rng, 0.8)])
    lean = -LEAN_RAD.get(vehicle, 0.0)
    if vehicle in LEAN_VARIES_RAD:
        lean += LEAN_VARIES_RAD[vehicle] * rng.uniform(-1, 1)
    return p, np.column_stack([bank, np.full(len(t), lean), yaw]) + wobble


def _waves(t: FloatArray, rng: np.random.Generator, amplitude: float) -> FloatArray:
    periods, phases = rng.uniform(2, 9, 3), rng.uniform(0, 2 * math.pi, 3)
    return np.asarray(
        amplitude / 1.7 * sum(np.sin(2 * math.pi * t / p + f) for p, f in zip(periods, phases, strict=True)), dtype=np.float64
    )


def flight_of(vehicle: str, seed: int, keep: Path) -> Flight:
    """A flight of a vehicle over the landscape of a seed, from the folder where it is kept if it is there."""
    file = keep / f"{vehicle}-{seed}.npz"
    if not file.exists():
        keep.mkdir(parents=True, exist_ok=True)
        np.savez(file, **_rendered(vehicle, seed))
    with np.load(file) as kept:
        surface = Surface(kept["surface"], kept["A_ne_pix"])
        return Flight(file.stem, vehicle, kept["frames"], kept["p"], kept["euler"], kept["height"], surface)


def _rendered(vehicle: str, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([seed, VEHICLES.index(vehicle)])
    size, gsd = SIZE_M[vehicle]
    dates = ("flight", "map") if seed % 2 else ("map", "flight")
    scene = build_landscape(seed, dates[0], size, gsd)  # type: ignore[arg-type]
    p, euler = path_of(vehicle, rng)
    p = p - (p.min(0) + p.max(0)) / 2
    room = np.maximum(size / 2 - EDGE_M[vehicle] - np.ptp(p, axis=0) / 2, 0)
    p = p + rng.uniform(-room, room)
    crs = map_crs(scene.crs)
    local = crs.linearised_at_map(*scene.center_map)
    origin = GeoPoint(*crs.to_geo(*local.origin_map_m), 0.0)
    J_ne_map = np.linalg.inv(local.J_map_ne)
    A_ne_pix = compose_affine(np.column_stack([J_ne_map, -J_ne_map @ np.array(local.origin_map_m)]), scene.T_map_pix)
    below = _at(scene, A_ne_pix, p)
    ground = np.convolve(np.pad(below, 10, mode="edge"), np.ones(21) / 21, "valid")
    up = float(np.median(ground)) + rng.uniform(*HEIGHT_M[vehicle]) + _waves(np.arange(FRAMES) * PERIOD_S, rng, 1.5)
    camera = CameraSimulator(scene, MODEL, CameraEffects())
    frames = np.empty((FRAMES, MODEL.height_px, MODEL.width_px), np.uint8)
    for k in range(FRAMES):
        place = geo_from_ned((float(p[k, 0]), float(p[k, 1]), -float(up[k])), origin)
        q = quat_from_euler(*(float(a) for a in euler[k]))
        frames[k] = cv2.cvtColor(camera.frame(place, q, int(rng.integers(2**31))), cv2.COLOR_RGB2GRAY)
    surface, A = _surface_model(seed, dates[1], size, A_ne_pix, gsd)
    ned = np.column_stack([p, -up])
    return {"frames": frames, "p": ned, "euler": euler, "height": up - below, "surface": surface, "A_ne_pix": A}


def _at(scene: Scene, A_ne_pix: FloatArray, ne: FloatArray) -> FloatArray:
    pix = apply_affine(invert_affine(A_ne_pix), ne).astype(np.float32)
    return np.asarray(cv2.remap(scene.dsm_amsl_m, pix[:, :1], pix[:, 1:], cv2.INTER_LINEAR), dtype=np.float64).ravel()


def _surface_model(seed: int, date: str, size: float, A_ne_pix: FloatArray, gsd: float) -> tuple[np.ndarray, FloatArray]:
    """The other date's surface at 1 m, on pixels of that size."""
    fine = build_landscape(seed, date, size, gsd).dsm_amsl_m  # type: ignore[arg-type]
    n = round(1.0 / gsd)
    coarse = cv2.resize(fine, (fine.shape[1] // n, fine.shape[0] // n), interpolation=cv2.INTER_AREA)
    grown = np.array([[n, 0.0, (n - 1) / 2], [0.0, n, (n - 1) / 2]])
    return np.asarray(coarse, dtype=np.float32), compose_affine(A_ne_pix, grown)


def sights(flight: Flight, errors: Errors, rng: np.random.Generator, knows: str) -> list[Sight]:
    """What the odometry is given: frames with disturbed attitudes and altitudes, and what `knows` names: `map`, a place on the
    other date's surface; `range`, a rangefinder; `home`, no more than the height above the start."""
    n = len(flight.frames)
    bias = np.array([*rng.normal(0, errors.tilt_rad, 2), rng.normal(0, errors.yaw_rad)])
    euler = flight.euler_rad + bias + rng.normal(0, errors.turn_rad, (n, 3))
    up = -flight.p_ned_m[:, 2] + rng.normal(0, errors.up_m) + rng.normal(0, errors.climb_m, n)
    height = flight.height_m + rng.normal(0, errors.range_m) + rng.normal(0, errors.range_m, n)
    place = flight.p_ned_m[:, :2] + rng.normal(0, errors.place_m, 2)
    found = []
    for k in range(n):
        q = quat_from_euler(*(float(a) for a in euler[k]))
        where = (float(place[k, 0]), float(place[k, 1]))
        given = Sight(flight.frames[k], round(k * PERIOD_S * 1e9), q, errors.tilt_rad, errors.yaw_rad, float(up[k]))
        if "map" in knows:
            given = replace(given, sigma_up_m=errors.up_m, place_ne_m=where, sigma_place_m=errors.place_m)
        if "range" in knows:
            given = replace(given, height_m=float(height[k]), sigma_height_m=errors.range_m, ranged=True)
        if "home" in knows:
            above = float(up[k] - up[0] + flight.height_m[0])
            given = replace(given, height_m=above, sigma_height_m=errors.home_m)
        found.append(given)
    return found
