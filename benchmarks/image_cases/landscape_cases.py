"""Case folders over the procedural landscape: frames of its later date on the map of the earlier one, with surface model.

Seeds below 100 are for training and fitting, the others for scoring only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.image_cases.cases import case_row, maker, truth_row, write_tables
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.maps.crs import map_crs
from visloc_companion.sim.land.season import Date
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, GeoPoint, Vec3

FIRST_SCORING_SEED = 100
SIDE_PX = 900
SMALLEST_FOOTPRINT_M = 80.0
"""70 m above the ground. From half of that, trees of 15 m lean over a third of the frame."""


@dataclass(frozen=True, slots=True)
class Worlds:
    """Which worlds and what is drawn of each: `per_seed` cases of a footprint of `foot_px` map pixels at one of `gsds_m`.

    The prior is uniform within ±offset (px), ±10 degrees and ±8 % of height; the tilt is up to `tilt_deg`, known to 0.3 degrees
    (1-sigma). `scene_of` makes the ground of a seed, date, side and pixel (metres); `least_m` is the smallest footprint over it.
    """

    seeds: tuple[int, ...]
    per_seed: int
    gsds_m: tuple[float, ...] = (0.3, 0.5, 1.0)
    foot_px: float = 128.0
    offset_px: float = 40.0
    tilt_deg: float = 5.0
    scene_of: Callable[[int, Date, float, float], Scene] = build_landscape
    least_m: float = SMALLEST_FOOTPRINT_M


def write_landscape(folder: Path, worlds: Worlds) -> Path:
    """Write the cases, or keep a folder that is complete; seed after seed, each world beside the cases."""
    if (folder / "cases.csv").exists():
        return folder
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    cases: list[dict[str, Any]] = []
    truths: list[dict[str, Any]] = []
    for number, seed in enumerate(worlds.seeds):
        gsd_m = worlds.gsds_m[number % len(worlds.gsds_m)]
        drawn = worlds.scene_of(seed, "map", SIDE_PX * gsd_m, gsd_m).save(folder / f"world{seed}")
        scene = worlds.scene_of(seed, "flight", SIDE_PX * gsd_m, gsd_m)
        camera = CameraSimulator(scene, _model(), CameraEffects())
        rng = np.random.default_rng([seed, 11])
        for k in range(worlds.per_seed):
            name = f"land{seed}_{k:03d}"
            place, attitude, above_m = _pose(rng, scene, worlds, gsd_m)
            pixels = camera.frame(place, quat_from_euler(*(math.radians(a) for a in attitude)), seed * 1000 + k)
            cv2.imwrite(str(folder / "frames" / f"{name}.png"), pixels[..., ::-1])
            cases.append(_case(name, drawn, rng, worlds, gsd_m, place, attitude, above_m))
            truths.append(truth_row(name, place, attitude, gsd_m, "flight"))
    return write_tables(folder, cases, truths)


def _model() -> CameraModel:
    tool = maker()
    return CameraModel(tool.FRAME_PX, tool.FRAME_PX, tool.FOCAL_PX, tool.FOCAL_PX, tool.CENTRE_PX, tool.CENTRE_PX)


def _pose(rng: np.random.Generator, scene: Scene, worlds: Worlds, gsd_m: float) -> tuple[GeoPoint, Vec3, float]:
    """Place, attitude (roll, pitch, yaw; degrees) and height above the ground of one frame."""
    foot_px = max(worlds.foot_px, worlds.least_m / gsd_m)
    above_m = foot_px * gsd_m / 2 / math.tan(math.radians(30))
    margin = 0.62 * foot_px + 0.1 * above_m / gsd_m
    col, row = rng.uniform(margin, SIDE_PX - margin, 2)
    half = int(foot_px / 2)
    under = scene.dsm_amsl_m[max(0, int(row) - half) : int(row) + half, max(0, int(col) - half) : int(col) + half]
    lat, lon = map_crs(scene.crs).to_geo(*(scene.T_map_pix @ np.array([col, row, 1.0])))
    tilt, direction = rng.uniform(0, worlds.tilt_deg), rng.uniform(0, 2 * math.pi)
    attitude = (tilt * math.sin(direction), tilt * math.cos(direction), float(rng.uniform(0, 360)))
    above_m *= 1 + rng.uniform(-0.08, 0.08)
    return GeoPoint(lat, lon, float(np.median(under)) + above_m), attitude, above_m


def _case(
    name: str,
    drawn: Sequence[Path],
    rng: np.random.Generator,
    worlds: Worlds,
    gsd_m: float,
    place: GeoPoint,
    attitude_deg: Vec3,
    above_m: float,
) -> dict[str, Any]:
    roll, pitch, yaw = attitude_deg
    north, east = rng.uniform(-worlds.offset_px, worlds.offset_px, 2) * gsd_m
    prior = geo_from_ned((north, east, rng.uniform(-0.08, 0.08) * above_m), place)
    turned = roll + rng.normal(0, 0.3), pitch + rng.normal(0, 0.3), yaw + rng.uniform(-10, 10)
    sigmas = {
        **{"sigma_horizontal_m": worlds.offset_px * gsd_m / 3**0.5, "sigma_h_m": 0.08 * above_m / 3**0.5},
        **{"sigma_yaw_deg": 10 / 3**0.5, "sigma_tilt_deg": 0.3},
    }
    return case_row(name, drawn, _model(), prior, turned, sigmas)
