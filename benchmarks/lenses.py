"""Wide lenses against pinhole cameras of their scale: errors of fixes and whether their claims hold, by how far the camera leans.

    python -m benchmarks.lenses [--lenses fisheye_120 pinhole_of_fisheye_120 ...] [--frames 20] [--width 640] [--seed 1]
                             [--method deep]

Frames of the flight's date over the procedural world, 80 to 140 m up, with any heading; the map is of another year. `--frames`
of each lens and each band of lean; every camera sees the same places and attitudes with the same priors, which are off by what
they say (1-sigma): 10 m, 2 % of height, 3 degrees of heading, 1 degree of tilt. Error over sigma: root mean square. `wrong`:
fixes that are off by more than 5 m and 4 sigma, and how many are claimed (the sum of `probability_wrong`).
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from benchmarks.pages.scenario_page import table
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.geo.se3 import quat_from_euler, quat_from_vector, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.registry import METHODS, make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FloatArray, FrameRef, GeoPoint, LocaliseRequest, PosePrior, Quat

FISHEYE = (0.02, -0.01, 0.003, -0.001)
RATIONAL = (1.2, 0.35, 3e-4, -2e-4, 0.01, 1.5, 0.7, 0.05)
WIDTH_PX = 640
BANDS_DEG = (0.0, 10.0, 25.0, 45.0)
PRIOR_M, HEIGHT_SHARE, YAW_RAD, TILT_RAD = 10.0, 0.02, math.radians(3.0), math.radians(1.0)
WRONG_M, WRONG_SIGMAS = 5.0, 4.0
COLUMNS = (
    *("lens", "leans", "fixes", "m median", "m largest", "north over sigma", "east", "height", "in 95 % ellipse"),
    *("wrong (claimed)", "no fix", "CPU s"),
)
View = tuple[GeoPoint, Quat, float]
"""A place, an attitude and the height above ground."""


def _fisheye(width_px: int, diagonal_deg: float) -> CameraModel:
    scale = width_px / WIDTH_PX
    focal_px = 400 * scale / math.radians(diagonal_deg / 2)
    return CameraModel(width_px, width_px * 3 // 4, focal_px, focal_px, 322 * scale, 236 * scale, FISHEYE, "fisheye")


def lens(name: str, width_px: int = WIDTH_PX) -> CameraModel:
    """A camera with 4:3 pixels: `fisheye_120` and `fisheye_150` (degrees from corner to corner, nearly), `rational` (about 100
    degrees across), `pinhole` (60 degrees across), or `pinhole_of_` one: without its distortion."""
    if name.startswith("pinhole_of_"):
        return replace(lens(name.removeprefix("pinhole_of_"), width_px), distortion=(0.0,) * 5, distortion_model="brown_conrady")
    if name.startswith("fisheye_"):
        return _fisheye(width_px, float(name.removeprefix("fisheye_")))
    scale, height_px = width_px / WIDTH_PX, width_px * 3 // 4
    if name == "rational":
        return CameraModel(width_px, height_px, 290 * scale, 291 * scale, 330 * scale, 230 * scale, RATIONAL, "rational")
    return CameraModel(width_px, height_px, 554.26 * scale, 554.26 * scale, (width_px - 1) / 2, (height_px - 1) / 2)


LENSES = tuple(of + name for name in ("fisheye_120", "fisheye_150", "rational") for of in ("", "pinhole_of_"))


def views(scene: Scene, rng: np.random.Generator, n: int, lean_deg: tuple[float, float]) -> Iterator[View]:
    """Poses over the middle of a scene, leaning to any side."""
    crs, size = map_crs(scene.crs), scene.size_px[0]
    for _ in range(n):
        above_m, tilt = rng.uniform(80, 140), math.radians(rng.uniform(*lean_deg))
        side, yaw = rng.uniform(0, 2 * math.pi, 2)
        column, row = rng.uniform(0.3, 0.7, 2) * size
        below = scene.dsm_amsl_m[int(row) - 80 : int(row) + 80, int(column) - 80 : int(column) + 80]
        lat, lon = crs.to_geo(*(scene.T_map_pix @ np.array([column, row, 1.0])))
        q = quat_from_euler(tilt * math.sin(side), tilt * math.cos(side), yaw)
        yield GeoPoint(lat, lon, float(np.median(below)) + above_m), q, above_m


def request_of(view: View, number: int, model: CameraModel) -> LocaliseRequest:
    """What is asked about a view; the prior's errors are the same for every camera."""
    rng = np.random.default_rng(number)
    place, q, above_m = view
    sigma_h_m = HEIGHT_SHARE * above_m
    north, east, down, turn = (rng.normal(0, 1, 4) * (PRIOR_M, PRIOR_M, sigma_h_m, YAW_RAD)).tolist()
    turned = quat_multiply(quat_from_vector((*rng.normal(0, TILT_RAD, 2).tolist(), turn)), q)
    cov = ((PRIOR_M**2, 0.0), (0.0, PRIOR_M**2))
    prior = PosePrior(geo_from_ned((north, east, down), place), turned, cov, sigma_h_m, YAW_RAD, TILT_RAD)
    return LocaliseRequest(number, FrameRef(0, 0, number, 0, model.width_px, model.height_px, 3), prior, 1)


def judged(fix: Fix, truth: GeoPoint) -> list[float]:
    """Error (m), over sigma north, east and up, squared in all of the two axes, and the claim that it is wrong."""
    north, east, down = ned_from_geo(fix.place, truth)
    off, cov = np.array([north, east]), np.array(fix.cov_ne_m2)
    over = (off / np.sqrt(np.diag(cov))).tolist()
    squared = float(off @ np.linalg.solve(cov, off))
    return [math.hypot(north, east), *over, -down / fix.sigma_h_m, squared, fix.probability_wrong]


def row(model: CameraModel, localiser: Localiser, scene: Scene, reference: ReferenceMap, shown: list[View]) -> list[str]:
    """Cells of a camera over some views."""
    camera, found, refused = CameraSimulator(scene, model, CameraEffects()), list[list[float]](), Counter[str]()
    cpu_s = 0.0
    for number, view in enumerate(shown):
        pixels = camera.frame(view[0], view[1], number)
        began = time.process_time()
        answer = localiser.localise(request_of(view, number, model), pixels, reference)
        cpu_s += time.process_time() - began
        if isinstance(answer, Fix):
            found.append(judged(answer, view[0]))
        else:
            refused[answer.reason.value] += 1
    return [*_cells(np.array(found).reshape(-1, 6)), _in_words(refused), f"{cpu_s / len(shown):.2f}"]


def _cells(rows: FloatArray) -> list[str]:
    if not len(rows):
        return ["0", *["–"] * 7]
    rms = np.sqrt((rows[:, 1:4] ** 2).mean(0))
    wrong = int(((rows[:, 0] > WRONG_M) & (rows[:, 4] > WRONG_SIGMAS**2)).sum())
    held = f"{100 * (rows[:, 4] < CHI2_95).mean():.0f} %"
    metres = f"{np.median(rows[:, 0]):.2f}", f"{rows[:, 0].max():.1f}"
    return [str(len(rows)), *metres, *(f"{x:.2f}" for x in rms), held, f"{wrong} ({rows[:, 5].sum():.2f})"]


def _in_words(refused: Counter[str]) -> str:
    return ", ".join(f"{reason} {n}" for reason, n in refused.most_common()) or "none"


def main() -> None:
    """Localise and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", nargs="+", choices=["pinhole", *LENSES], default=["pinhole", *LENSES])
    parser.add_argument("--frames", type=int, default=20, help="of each lens and band of lean")
    parser.add_argument("--width", type=int, default=WIDTH_PX, help="columns of the cameras")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--method", choices=METHODS, default="deep")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    files = procedural_world(options.seed)
    scene, reference = Scene.load(files.flight_ortho, files.flight_dsm), PackMap.open(files.pack, verify_hashes=False)
    features = open_features_for(options.method, NetworkChoice(threads=1))
    print(table(COLUMNS, []), flush=True)
    for band in pairwise(BANDS_DEG):
        shown = list(views(scene, np.random.default_rng(options.seed), options.frames, band))
        for name in options.lenses:
            model = lens(name, options.width)
            localiser = make_localiser(options.method, model, features=features)
            cells = row(model, localiser, scene, reference, shown)
            print(f"| {name} | {band[0]:.0f} to {band[1]:.0f}° | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
