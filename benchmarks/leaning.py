"""Fixes of a camera that leans, over woods and elsewhere, with and without the surface model's errors in the pose's solution.

    python -m benchmarks.leaning [--worlds 40 41 ...] [--frames 40] [--tilt 1.0] [--largest 35]

The map is of an early summer. Seen are a leafless March five years later, the same with crowns so thin that a fifth of their
height shows, and a summer eight years later: woods bare, felled, grown and planted. The camera is 80 to 150 m up, leans by up to
`--largest` degrees to any side and has any heading; every other frame looks at a wood. The prior is off by what it says
(1-sigma): 2 m, 1.5 m of height, 2 degrees of heading, `--tilt` degrees of tilt. Every frame is localised twice, once as if the
surface model were exact.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.landscape import MODEL, localiser_of
from benchmarks.pages.scenario_page import table
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler, quat_from_vector, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.candidates import block_pose
from visloc_companion.localise.mapped.surface_error import height_covariance
from visloc_companion.localise.ortho_rectify import MapGrid
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import Localiser
from visloc_companion.sim.land.landscape_grid import Grid
from visloc_companion.sim.land.landscape_noise import Raster
from visloc_companion.sim.land.landscape_plan import make_plan
from visloc_companion.sim.land.landscape_terrain import terrain
from visloc_companion.sim.land.season import FLIGHT, MAP
from visloc_companion.sim.landscape import build_landscape
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Fix, FloatArray, FrameRef, GeoPoint, Image, LocaliseRequest, PosePrior, Quat

SIZE_M, GSD_M = 1000.0, 0.5
DATES = (
    FLIGHT,
    replace(FLIGHT, bare_height=0.2, bare_alpha=0.3),
    replace(MAP, years=8.0, sun_azimuth_deg=200.0, sun_elevation_deg=45.0),
)
ABOVE_M, BANDS_DEG = (80.0, 150.0), (0.0, 10.0, 35.0, 90.0)
TREE_M, WOODED = 3.0, 0.35
"""What is higher stands on the ground; a view of a wood has this share of it or more."""
PRIOR_M, HEIGHT_M, YAW_RAD = 2.0, 1.5, math.radians(2.0)
COLUMNS = ("view", "surface model", "fixes", "m rms", "median", "95 %", "height m rms", "over sigma", "height", "in 95 % ellipse")
View = tuple[GeoPoint, Quat, float, bool]
"""A pose, its lean (degrees), and whether it looks at a wood."""
Row = tuple[float, ...]
"""Error north, east, up (m); the same over sigma; squared in all, of two axes; lean (degrees); whether it looks at a wood."""


def exact(_: MapGrid, at_px: FloatArray, side_px: float) -> FloatArray:
    """In place of `height_covariance`: heights that do not err."""
    return np.zeros((len(at_px), len(at_px)))


SURFACES = {"exact": exact, "may err": height_covariance}


def views(
    scene: Scene, ground_m: Raster, stands_m: Raster, rng: np.random.Generator, n: int, largest_deg: float
) -> Iterator[View]:
    """Poses over a scene, of whose grid the ground and the height of what stands on it are known; every other one of a wood."""
    crs, size = map_crs(scene.crs), scene.size_px[0]
    while n:
        above, tilt = rng.uniform(*ABOVE_M), math.radians(rng.uniform(0, largest_deg))
        side, yaw = rng.uniform(0, 2 * math.pi, 2)
        q = quat_from_euler(tilt * math.sin(side), tilt * math.cos(side), yaw)
        axis, at = R_from_quat(q)[:, 2], rng.uniform(0.06, 0.94, 2) * size
        col, row = np.rint(at + np.array([axis[1], -axis[0]]) / axis[2] * above / GSD_M).astype(int).tolist()
        half = round(0.55 * above / GSD_M)
        if min(col, row) < half or max(col, row) >= size - half:
            continue
        seen = slice(row - half, row + half), slice(col - half, col + half)
        wooded = float((stands_m[seen] > TREE_M).mean()) >= WOODED
        if n % 2 and not wooded:
            continue
        n -= 1
        lat, lon = crs.to_geo(*(scene.T_map_pix @ np.array([*at, 1.0])))
        yield GeoPoint(lat, lon, float(np.median(ground_m[seen])) + above), q, math.degrees(tilt), wooded


def request_of(view: View, number: int, rng: np.random.Generator, sigma_tilt_rad: float) -> LocaliseRequest:
    """What is asked about a view, with a prior that errs as it says."""
    north, east, down, turn = (rng.normal(0, 1, 4) * (PRIOR_M, PRIOR_M, HEIGHT_M, YAW_RAD)).tolist()
    turned = quat_from_vector((*rng.normal(0, sigma_tilt_rad, 2).tolist(), turn))
    place, attitude = geo_from_ned((north, east, down), view[0]), quat_multiply(turned, view[1])
    cov = ((PRIOR_M**2, 0.0), (0.0, PRIOR_M**2))
    frame = FrameRef(number, number, number, 0, MODEL.width_px, MODEL.height_px, 3)
    return LocaliseRequest(number, frame, PosePrior(place, attitude, cov, HEIGHT_M, YAW_RAD, sigma_tilt_rad), 1)


def judged(fix: Fix, view: View) -> Row:
    """A fix against the truth."""
    north, east, down = ned_from_geo(fix.place, view[0])
    off, cov = np.array([north, east]), np.array(fix.cov_ne_m2)
    over = *(off / np.sqrt(np.diag(cov))).tolist(), -down / fix.sigma_h_m
    return north, east, -down, *over, float(off @ np.linalg.solve(cov, off)), *view[2:]


class Shot(NamedTuple):
    """One frame of a view, with what is asked about it and what more is drawn of chance."""

    date: int
    view: View
    pixels: Image
    request: LocaliseRequest
    rng: np.random.Generator


def shots(seed: int, n: int, sigma_tilt_rad: float, largest_deg: float) -> Iterator[Shot]:
    """`n` frames of each date over the procedural world of a seed."""
    ground_m = terrain(seed, Grid(round(SIZE_M / GSD_M), GSD_M), make_plan(seed, SIZE_M))
    stands_m = np.asarray(build_landscape(seed, "map", SIZE_M, GSD_M).dsm_amsl_m - ground_m, dtype=np.float32)
    for date, season in enumerate(DATES):
        scene = build_landscape(seed, season, SIZE_M, GSD_M)
        camera, rng = CameraSimulator(scene, MODEL, CameraEffects()), np.random.default_rng([seed, date])
        for number, view in enumerate(views(scene, ground_m, stands_m, rng, n, largest_deg)):
            pixels = camera.frame(view[0], view[1], 1000 * seed + 100 * date + number)
            yield Shot(date, view, pixels, request_of(view, number, rng, sigma_tilt_rad), rng)


def opened(seed: int) -> tuple[PackMap, Localiser]:
    """The map of the procedural world of a seed, and who localises."""
    return PackMap.open(procedural_world(seed, size_m=SIZE_M).pack, verify_hashes=False), localiser_of("deep")


def of_world(seed: int, n: int, sigma_tilt_rad: float, largest_deg: float) -> Iterator[tuple[str, Row]]:
    """All fixes over the procedural world of a seed, of `n` frames of each date, with what the surface model was taken for."""
    reference, localiser = opened(seed)
    for shot in shots(seed, n, sigma_tilt_rad, largest_deg):
        for name, heights in SURFACES.items():
            with patch.object(block_pose, "height_covariance", heights):
                answer = localiser.localise(shot.request, shot.pixels, reference)
            if isinstance(answer, Fix):
                yield name, judged(answer, shot.view)


def cells(rows: FloatArray) -> list[str]:
    """Figures of fixes (N, 9)."""
    off_m, rms = np.hypot(rows[:, 0], rows[:, 1]), np.sqrt((rows**2).mean(axis=0))
    horizontal = math.hypot(rms[0], rms[1]), float(np.median(off_m)), float(np.percentile(off_m, 95)), rms[2]
    over = math.sqrt(float(rows[:, 6].mean()) / 2), rms[5]
    return [str(len(rows)), *(f"{x:.2f}" for x in (*horizontal, *over)), f"{100 * (rows[:, 6] < CHI2_95).mean():.1f} %"]


def main(argv: Sequence[str] | None = None) -> None:
    """Localise and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, nargs="+", default=[40, 41, 42, 43])
    parser.add_argument("--frames", type=int, default=40, help="of each of the three dates over each world")
    parser.add_argument("--tilt", type=float, default=1.0, help="1-sigma of the prior's tilt, degrees")
    parser.add_argument("--largest", type=float, default=35.0, help="lean, degrees")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    sigma_rad = math.radians(options.tilt)
    found = [each for seed in options.worlds for each in of_world(seed, options.frames, sigma_rad, options.largest)]
    lines = []
    for (low, high), wooded in product(reversed(list(pairwise(BANDS_DEG))), (1, 0)):
        what = f"{'a wood' if wooded else 'elsewhere'}, leans {low:.0f} to {min(high, options.largest):.0f}°"
        for name in SURFACES:
            rows = np.array([row for each, row in found if each == name]).reshape(-1, 9)
            rows = rows[(rows[:, 8] == wooded) & (rows[:, 7] >= low) & (rows[:, 7] < high)]
            lines += [[what, name, *cells(rows)]] if len(rows) else []
    print(table(COLUMNS, lines))


if __name__ == "__main__":
    main()
