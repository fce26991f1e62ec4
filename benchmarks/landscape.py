"""How hard the two dates of the procedural landscape are for each localiser.

    python -m benchmarks.landscape [--frames 60] [--seed 1] [--methods deep,gradient,ncc,keypoint] [--json FILE]
        [--max-probability-wrong 0.01]

Frames of the flight's date are rendered with tilt, lens and sensor effects at about 120 m above ground and any heading; each
localiser gets the pack of the map's date, with its features, as its reference and a prior drawn with 10 m horizontal, 3 degrees
of heading, 2 % of height and 1 degree of tilt (1-sigma each). A fix within 5 m horizontally is a success.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.crs import map_crs
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.protocols import Localiser, ReferenceMap
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scene import Scene
from visloc_companion.types import CameraModel, Fix, FrameRef, GeoPoint, Image, LocaliseRequest, PosePrior

MODEL = CameraModel(640, 480, 554.26, 554.26, 319.5, 239.5, (-0.08, 0.01, 0.0, 0.0, 0.0))
SIGMA_M, SIGMA_YAW_RAD, SIGMA_H_SHARE, SIGMA_TILT_RAD = 10.0, math.radians(3.0), 0.02, math.radians(1.0)
SUCCESS_M = 5.0


def cases(scene: Scene, seed: int, n: int) -> list[tuple[GeoPoint, Image, LocaliseRequest]]:
    """True place, frame and request of each case."""
    simulator = CameraSimulator(scene, MODEL, CameraEffects())
    rng = np.random.default_rng(seed)
    crs = map_crs(scene.crs)
    width, height = scene.size_px
    found = []
    for number in range(n):
        column, row = rng.uniform(0.12, 0.88) * width, rng.uniform(0.12, 0.88) * height
        lat, lon = crs.to_geo(*(scene.T_map_pix @ np.array([column, row, 1.0])))
        ground_m = float(np.median(scene.dsm_amsl_m[int(row) - 100 : int(row) + 100, int(column) - 100 : int(column) + 100]))
        above_m = rng.uniform(105, 135)
        place = GeoPoint(lat, lon, ground_m + above_m)
        roll, pitch, yaw = rng.normal(0, math.radians(3)), rng.normal(0, math.radians(3)), rng.uniform(-math.pi, math.pi)
        pixels = simulator.frame(place, quat_from_euler(roll, pitch, yaw), seed * 1000 + number)
        sigma_h_m = SIGMA_H_SHARE * above_m
        n_off, e_off, d_off = rng.normal(0, SIGMA_M), rng.normal(0, SIGMA_M), rng.normal(0, sigma_h_m)
        tilt = rng.normal(0, SIGMA_TILT_RAD, 2)
        q_prior = quat_from_euler(roll + tilt[0], pitch + tilt[1], yaw + rng.normal(0, SIGMA_YAW_RAD))
        cov = ((SIGMA_M**2, 0.0), (0.0, SIGMA_M**2))
        prior = PosePrior(geo_from_ned((n_off, e_off, d_off), place), q_prior, cov, sigma_h_m, SIGMA_YAW_RAD, SIGMA_TILT_RAD)
        frame = FrameRef(0, 0, number, 0, MODEL.width_px, MODEL.height_px, 3)
        found.append((place, pixels, LocaliseRequest(number, frame, prior, seed)))
    return found


def localiser_of(method: str, max_probability_wrong: float = 0.05) -> Localiser:
    """The localiser of a name for the camera of these cases, on one thread."""
    features = open_features_for(method, NetworkChoice(threads=1))
    return make_localiser(method, MODEL, features=features, max_probability_wrong=max_probability_wrong)


def judge(
    method: str, reference: ReferenceMap, todo: list[tuple[GeoPoint, Image, LocaliseRequest]], max_probability_wrong: float = 0.01
) -> dict[str, object]:
    """Success, wrong fixes, reasons and errors of one method."""
    localiser = localiser_of(method, max_probability_wrong)
    errors: list[float] = []
    reasons: dict[str, int] = {}
    started = time.process_time()
    for place, pixels, request in todo:
        answer = localiser.localise(request, pixels, reference)
        if isinstance(answer, Fix):
            errors.append(distance_m(answer.place, place))
        else:
            reasons[answer.reason.value] = reasons.get(answer.reason.value, 0) + 1
    good = [error for error in errors if error <= SUCCESS_M]
    return {
        "method": method,
        "frames": len(todo),
        "success": len(good) / len(todo),
        "wrong_fixes": len(errors) - len(good),
        "no_fix": reasons,
        "median_error_m": float(np.median(good)) if good else None,
        "cpu_ms_per_frame": 1000 * (time.process_time() - started) / len(todo),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--methods", default="deep,gradient,ncc,keypoint")
    parser.add_argument("--max-probability-wrong", type=float, default=0.01, help="fixes above it are declined")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for the frames")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    world = procedural_world(options.seed)
    todo = cases(Scene.load(world.flight_ortho, world.flight_dsm), options.seed, options.frames)
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
        for number, (_, pixels, _) in enumerate(todo):
            cv2.imwrite(str(options.pictures / f"{number:03}.png"), pixels[:, :, ::-1])
    reference = PackMap.open(world.pack, verify_hashes=False)
    results = [judge(method, reference, todo, options.max_probability_wrong) for method in options.methods.split(",")]
    for row in results:
        median = row["median_error_m"]
        print(
            f"{row['method']:10} success {row['success']:6.1%}  wrong {row['wrong_fixes']:3}  median "
            f"{'-' if median is None else f'{median:.2f} m'}  {row['cpu_ms_per_frame']:.0f} ms  {row['no_fix']}"
        )
    if options.json:
        options.json.write_text(json.dumps({"schema": 1, "seed": options.seed, "results": results}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
