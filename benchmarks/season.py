"""Deep snow against a map of a summer: what each vote answers along the loop, and the flight `season_change`.

    python -m benchmarks.season [--step 40] [--sigma 6] [--methods deep gradient] [--report FILE] [--skip places|flights]

First, every `--step` metres of the loop that the scenarios fly, 120 m above the ground: five frames 12 m apart, all with a prior
off by the same `--sigma` (1-sigma horizontally; 2 m in height, 2 degrees of heading), 0.3 m and 0.5 degrees of tilt each beside.
The image's vote is asked about the last of them. Then the flight with and without the structure vote, and without the daemon.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from visloc_companion.evaluate.campaign import FlightSpec, find_scenario, fly_spec
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, FlightWorld, FlownScenario, fault_intervals
from visloc_companion.evaluate.flight_pictures import picture_pairs
from visloc_companion.evaluate.map_image import map_image
from visloc_companion.evaluate.metrics import fix_errors_m
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.geo.wgs84 import geo_from_ned, ned_from_geo
from visloc_companion.localise.flight import flight_registration
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.localise.structure.localiser import METHOD, StructureLocaliser
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world, scene_on
from visloc_companion.protocols import Localiser
from visloc_companion.sim.render import CameraSimulator
from visloc_companion.sim.rendering.render_effects import CameraEffects
from visloc_companion.sim.scenarios import SEASON_CHANGE
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup
from visloc_companion.types import (
    AutopilotKind,
    CameraModel,
    Fix,
    FloatArray,
    FrameRef,
    GeoPoint,
    Image,
    LocaliseRequest,
    NoFix,
    PosePrior,
)

FRAMES, APART_M = 5, 12.0
SIGMA_H_M, SIGMA_YAW_RAD, SIGMA_TILT_RAD, SIGMA_EACH_M = 2.0, math.radians(2.0), math.radians(0.5), 0.3
MOST_WRONG = 0.05
PICTURES_S = (45.0, 80.0, 115.0, 145.0)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A frame, what is asked about it, and where it was taken."""

    place: GeoPoint
    pixels: Image
    request: LocaliseRequest


def loop(setup: FlightSetup, step_m: float) -> list[tuple[FloatArray, float]]:
    """Places (NED about home) along the mission and the heading there."""
    way = [np.array(point) for point in setup.mission_ned_m()]
    places = []
    for a, b in zip(way, [*way[1:], way[0]], strict=True):
        length = float(np.linalg.norm(b - a))
        heading = math.atan2(b[1] - a[1], b[0] - a[0])
        places += [(a + (b - a) * k * step_m / length, heading) for k in range(int(length // step_m))]
    return places


def shots_at(number: int, at: tuple[FloatArray, float], home: GeoPoint, camera: CameraSimulator, sigma_m: float) -> list[Shot]:
    """Frames up to a place, the last one there."""
    place_m, heading = at
    rng = np.random.default_rng([number, 5])
    along = np.array([math.cos(heading), math.sin(heading), 0.0]) * APART_M
    shared = np.array([*rng.normal(0, sigma_m, 2), rng.normal(0, SIGMA_H_M)])
    turned = rng.normal(0, SIGMA_YAW_RAD)
    shots = []
    for k in range(FRAMES):
        north, east, down = (float(value) for value in place_m - along * (FRAMES - 1 - k))
        place = geo_from_ned((north, east, down), home)
        roll, pitch = rng.normal(0, math.radians(2), 2)
        pixels = camera.frame(place, quat_from_euler(roll, pitch, heading), number * 100 + k)
        tilt = rng.normal(0, SIGMA_TILT_RAD, 2)
        off = tuple(float(value) for value in shared + rng.normal(0, SIGMA_EACH_M, 3))
        believed = geo_from_ned((off[0], off[1], off[2]), place)
        attitude = quat_from_euler(roll + tilt[0], pitch + tilt[1], heading + turned)
        cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
        prior = PosePrior(believed, attitude, cov, SIGMA_H_M, math.radians(5), math.radians(1))
        model = camera.model
        frame = FrameRef(k, (k + 1) * 1_000_000_000, k, 0, model.width_px, model.height_px, 3)
        shots.append(Shot(place, pixels, LocaliseRequest(k, frame, prior, number)))
    return shots


def structure_over(shots: list[Shot], model: CameraModel, reference: PackMap) -> Localiser:
    """The structure localiser when it has seen the frames."""
    settings = LocaliserSettings(MOST_WRONG)
    structure = StructureLocaliser(model, settings, flight_registration())
    for shot in shots:
        structure.remember(shot.request, shot.pixels, reference)
    return structure


def places(world: FlightWorld, methods: list[str], step_m: float, sigma_m: float) -> None:
    """Print what each vote answers along the loop."""
    setup = FlightSetup(SEASON_CHANGE, world.area(), AutopilotKind.ARDUPILOT, "copter", 1)
    model = setup.camera_model()
    camera = CameraSimulator(world.scene, model, CameraEffects())
    choice = NetworkChoice(threads=1)
    images = {
        name: make_localiser(name, model, features=open_features_for(name, choice), max_probability_wrong=MOST_WRONG)
        for name in methods
    }
    answers: dict[str, list[tuple[Fix | NoFix, list[Shot]]]] = {name: [] for name in (*methods, METHOD)}
    for number, at in enumerate(loop(setup, step_m)):
        shots = shots_at(number, at, setup.area.home, camera, sigma_m)
        for name, given in answers.items():
            localiser = images.get(name) or structure_over(shots, model, world.reference)
            given.append((localiser.localise(shots[-1].request, shots[-1].pixels, world.reference), shots))
    header = "| vote | places | answered | median m | max m | > 5 m | completeness 5, 50, 95 % | refused |"
    print(f"prior good to {sigma_m:g} m\n{header}\n|{'---|' * 8}")
    for name, given in answers.items():
        off = [math.hypot(*ned_from_geo(a.place, shots[a.frame_id].place)[:2]) for a, shots in given if isinstance(a, Fix)]
        complete = [dict(a.evidence)["completeness"] for a, _ in given if "completeness" in dict(a.evidence)]
        spread = ", ".join(f"{100 * v:.0f}" for v in np.percentile(complete, (5, 50, 95))) if complete else "–"
        reasons = Counter(a.reason.value for a, _ in given if isinstance(a, NoFix))
        print(
            f"| {name} | {len(given)} | {len(off) / len(given):.0%} | {np.median(off):.2f} | {max(off):.2f} | "
            f"{sum(o > 5 for o in off)} | {spread} | {', '.join(f'{k} {n}' for k, n in reasons.most_common())} |",
            flush=True,
        )


def row(name: str, flown: FlownScenario) -> str:
    """A flight as a row: errors of the positions sent since the jamming, and the fixes of that time by vote."""
    record, start_s = flown.record, SEASON_CHANGE.fault_start_s
    error = record.error_m[(record.t_s >= start_s) & record.injected]
    error = error[np.isfinite(error)]
    values = (np.median(error), np.percentile(error, 95), error.max()) if len(error) else ()
    spread = " | ".join(f"{value:.1f}" for value in values) or "– | – | –"
    off_m = fix_errors_m(record)
    by_vote = []
    for method in sorted({fix.method for fix in record.fixes}):
        mine = np.array([o for o, fix in zip(off_m, record.fixes, strict=True) if fix.method == method and fix.t_s >= start_s])
        asked = len(mine) + sum(r.method == method and r.t_s >= start_s for r in record.refusals)
        if len(mine):
            by_vote.append(f"{method} {len(mine)} of {asked} ({np.median(mine):.1f}, at most {mine.max():.1f} m)")
    summary = flown.summary
    end = flown.log.truth[-1].off_m
    return (
        f"| {name} | {spread} | {', '.join(by_vote) or '–'} | {summary['hmi']} | {summary['nees']} | "
        f"{flown.log.failsafe or 'none'} | {'no position' if end is None else f'{end:.0f} m'} |"
    )


def flights(spec: FlightSpec, world: FlightWorld, report: Path | None) -> None:
    """Fly with and without the structure vote and without the daemon; print, and write the report of the first."""
    header = "flight | median m | 95 % m | max m | fixes of requests (median error) | HMI | NEES | failsafe | off at the end"
    print(f"| {header} |\n|{'---|' * (header.count('|') + 1)}")
    whole = fly_spec(spec)
    print(row("with structure", whole), flush=True)
    image = fly_spec(replace(spec, structure=False))
    print(row("image alone", image), flush=True)
    alone = fly_spec(replace(spec, with_daemon=False))
    print(row("without the daemon", alone), flush=True)
    for check in whole.checks:
        print(f"{'ok' if check.passed else 'FAIL'} {check.name}: {check.value} (limit {check.limit})")
    if report is None:
        return
    error = image.record.error_m[(image.record.t_s >= SEASON_CHANGE.fault_start_s) & image.record.injected]
    write_flight_report(
        whole.record,
        report,
        title="GNSS loss over deep snow, the map of a summer: simulated copter, image and structure",
        checks=whole.checks,
        baseline=alone.record,
        map_image=map_image(world.reference, whole.record, alone.record),
        alert_limit_m=ALERT_LIMIT_M,
        gnss_faults_s=fault_intervals(SEASON_CHANGE),
        notes=[
            "A simulated flight over the procedural landscape. The map is of a summer morning; the camera sees the same place "
            "five years later on a winter afternoon after a snowstorm. Images are matched where enough of the map's edges are "
            "still to be seen; elsewhere the shape of the ground, from motion stereo, gives the fixes.",
            f"The same flight with the image alone: error without GNSS {np.nanmedian(error):.1f} m (median), "
            f"{np.nanmax(error):.1f} m (maximum), {len(image.record.fixes)} fixes, failsafe {image.log.failsafe or 'none'}.",
        ],
        pictures=picture_pairs(whole, world, PICTURES_S),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step", type=float, default=40.0)
    parser.add_argument("--sigma", type=float, default=6.0)
    parser.add_argument("--methods", nargs="+", default=["deep", "gradient"])
    parser.add_argument("--report", type=Path)
    parser.add_argument("--skip", choices=["places", "flights"])
    options = parser.parse_args()
    cv2.setNumThreads(1)
    made = procedural_world(1)
    ortho, dsm = scene_on(made, find_scenario(SEASON_CHANGE.name).date, 1)
    world = FlightWorld(made.pack, PackMap.open(made.pack, verify_hashes=False), Scene.load(ortho, dsm))
    if options.skip != "places":
        places(world, options.methods, options.step, options.sigma)
    if options.skip != "flights":
        flights(FlightSpec(SEASON_CHANGE.name, made.pack, ortho, dsm), world, options.report)


if __name__ == "__main__":
    main()
