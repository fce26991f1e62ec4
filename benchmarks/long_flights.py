"""Ten minutes without GNSS in closed loop, over pictures: `python -m benchmarks.long_flights [--worlds ...] [--json FILE]`.

Copter at 10 m/s and plane at 25 m/s, GNSS jammed after a minute; image, structure (where the map has heights) and odometry as the
daemon asks for them by default. Two worlds: the procedural landscape of two dates (map of summer, 0.5 m a pixel; the camera sees
the leafless date) and NAIP of two years (map 2018, camera 2016, 5 m a pixel; needs ../shared/data/naip).

One row a flight: share of the time within the goal (3 m, or 1.5 pixels of a coarse map), error, level, epochs beyond it,
hazardous ones, NEES (2 is right), fixes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from benchmarks.flights import CAMERA_YEAR, MAP_YEAR
from benchmarks.image_cases.cases import SHARED
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, FlightWorld, FlownScenario, fly
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim import faults
from visloc_companion.sim.scenarios import Scenario
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind

JAM_S = 60.0
GOAL_M, GOAL_PX = 3.0, 1.5
HEADER = (
    "| world | vehicle | within goal | error 50 / 95 / max m | level 50 m | beyond | HMI | NEES | fixes of frames | failsafe |"
)


@contextmanager
def open_world(name: str) -> Iterator[FlightWorld]:
    """The map and what the camera sees of another date."""
    if name == "procedural":
        world = procedural_world(1)
        yield _world(world.pack, world.flight_ortho, world.flight_dsm)
        return
    naip = SHARED / "data" / "naip"
    with tempfile.TemporaryDirectory() as folder:
        pack = Path(folder) / "pack"
        sources = [naip / f"{MAP_YEAR}.tif"]
        build_pack(sources, None, pack, source="USDA NAIP", licence="public domain", networks=[open_features()])
        yield _world(pack, naip / f"{CAMERA_YEAR}.tif", None)


def _world(pack: Path, ortho: Path, dsm: Path | None) -> FlightWorld:
    reference = PackMap.open(pack, verify_hashes=False)
    ground = float(np.nan_to_num(reference.height_amsl_m(*reference.center_map_m)))
    return FlightWorld(pack, reference, Scene.load(ortho, dsm, ground))


def flown(world: FlightWorld, vehicle: VehicleKind, minutes: float, seed: int) -> FlownScenario:
    """One flight, jammed after a minute for so many."""
    summary = f"GNSS is jammed for {minutes:g} minutes."
    scenario = Scenario("long_jam", summary, JAM_S + 60 * minutes, faults.jam(JAM_S))
    return fly(FlightSetup(scenario, world.area(), AutopilotKind.ARDUPILOT, vehicle, seed), world)


def figures(one: FlownScenario, gsd_m: float) -> dict[str, Any]:
    """What is printed: of all epochs that were injected without GNSS."""
    record = one.record
    relied_on = (record.t_s >= JAM_S) & record.injected
    error, level = record.error_m[relied_on], record.protection_level_m[relied_on]
    goal_m = max(GOAL_M, GOAL_PX * gsd_m)
    without = record.t_s >= JAM_S
    return {
        "goal_m": goal_m,
        "within_goal": float((error <= goal_m).sum() / without.sum()),
        "error_m": [float(v) for v in np.percentile(error, [50, 95, 100])],
        "level_median_m": float(np.median(level)),
        "beyond_level": int((error > level).sum()),
        "epochs": int(without.sum()),
        "hmi": one.summary["hmi"],
        "nees": one.summary["nees"],
        "fixes": one.summary["n_fixes"],
        "frames": one.summary["n_fixes"] + one.summary["n_no_fix"],
        "failsafe": one.log.failsafe or "none",
    }


def row(world: str, vehicle: str, f: dict[str, Any]) -> str:
    """A flight as a row of the table."""
    cells = [
        *(world, vehicle, f"{100 * f['within_goal']:.1f} % ≤ {f['goal_m']:g} m"),
        " / ".join(f"{v:.2f}" for v in f["error_m"]),
        *(f"{f['level_median_m']:.1f}", f"{f['beyond_level']} of {f['epochs']}", f"{f['hmi']}", f"{f['nees']:.2f}"),
        *(f"{f['fixes']} of {f['frames']}", f["failsafe"]),
    ]
    return f"| {' | '.join(cells)} |"


def main(argv: Sequence[str] | None = None) -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--worlds", nargs="+", default=["procedural", "naip"], choices=["procedural", "naip"])
    parser.add_argument("--vehicles", nargs="+", default=["copter", "plane"], choices=["copter", "plane"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", type=Path, help="folder for an HTML report of each flight")
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    rows = []
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}", flush=True)
    for name in args.worlds:
        with open_world(name) as world:
            for vehicle in args.vehicles:
                one = flown(world, cast("VehicleKind", vehicle), args.minutes, args.seed)
                f = figures(one, world.reference.gsd_m)
                rows.append({"world": name, "vehicle": vehicle, **f})
                print(row(name, vehicle, f), flush=True)
                if args.report:
                    title = f"{args.minutes:g} minutes without GNSS, {name}, {vehicle}"
                    path = args.report / f"{name}-{vehicle}.html"
                    write_flight_report(one.record, path, title=title, checks=[], alert_limit_m=ALERT_LIMIT_M)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
