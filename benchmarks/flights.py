"""Closed-loop flights: the scenarios over the procedural world, and GNSS loss over NAIP of two years, by method.

    python -m benchmarks.flights [--jobs N] [--worlds procedural naip] [--methods deep gradient] [--other-years N]
        [--naip-report FILE]

Prints a markdown table of the flights, and one of what each method made of all frames of a world. The camera's date is never the
map's; the low flight has a footprint of 64 map pixels instead of 173. `--other-years` flies over a pack of so many years more,
never the camera's. `--naip-report` writes the HTML report of the first method's flight through spoofing and jamming over NAIP.
Needs ../shared/data/naip for the second world.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.dates import dates_from
from benchmarks.image_cases.cases import SHARED
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate.campaign import FlightSpec, campaign_specs, find_scenario, fly_spec, result_of
from visloc_companion.evaluate.closed_loop import ALERT_LIMIT_M, fault_intervals
from visloc_companion.evaluate.metrics import fix_errors_m
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.registry import METHODS
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import procedural_world
from visloc_companion.types import FloatArray

MAP_YEAR, CAMERA_YEAR = "20180716", "20160816"
MAP_PX_M = 5.0
LOW_M = 64 * MAP_PX_M / (2 * math.tan(math.radians(30)))
"""From so high 60 degrees cover 64 pixels of the map."""
NAIP_FLIGHTS: tuple[dict[str, Any], ...] = (
    {"scenario": "demo"},
    {"scenario": "jam"},
    {"scenario": "slow_drag"},
    {"scenario": "jam", "vehicle": "plane"},
    {"scenario": "jam", "height_m": LOW_M},
)
HEADER = (
    "| world | scenario | autopilot | method | passed | without GNSS: median m | max m | GNSS bad after s | pulled m | fixes | "
    "refused | availability | HMI | NEES | failsafe | without the daemon |"
)
GAIN_HEADER = (
    "| world | method | flights passed | frames answered | with a fix | fix off: median m | p95 m | position off: "
    "median m | p95 m | availability | HMI | ms a frame |"
)


@dataclass(frozen=True, slots=True)
class Flown:
    """What a flight showed: its result, how far each fix and each epoch's position were off (m), and ms of each frame."""

    result: dict[str, Any]
    fix_off_m: FloatArray
    off_m: FloatArray
    took_ms: FloatArray


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--worlds", nargs="+", default=["procedural", "naip"], choices=["procedural", "naip"])
    parser.add_argument("--methods", nargs="+", default=["deep", "gradient"], choices=METHODS)
    parser.add_argument("--other-years", type=int, default=0)
    parser.add_argument("--naip-report", type=Path)
    options = parser.parse_args()
    if "procedural" in options.worlds:
        world = procedural_world(1)
        template = FlightSpec("jam", world.pack, world.flight_ortho, world.flight_dsm)
        report("procedural, 0.5 m/px", campaign_specs("scenarios", template), options.methods, options.jobs)
    with tempfile.TemporaryDirectory() as folder:
        base = naip_base(Path(folder), options.other_years) if "naip" in options.worlds else None
        if base is not None:
            report("NAIP, 5 m/px", [replace(base, **each) for each in NAIP_FLIGHTS], options.methods, options.jobs)
            if options.naip_report:
                naip_report(replace(base, scenario="demo", method=options.methods[0]), options.naip_report)


def naip_base(folder: Path, other_years: int = 0) -> FlightSpec | None:
    """What all flights over NAIP have in common, with a pack that is built in a folder, of so many years more than the map's;
    None without the pictures."""
    naip, pack = SHARED / "data" / "naip", folder / "pack"
    if not naip.is_dir():
        return None
    first, *others = dates_from(naip, MAP_YEAR, CAMERA_YEAR)[: 1 + other_years]
    origin = {"source": "USDA NAIP", "licence": "public domain"}
    build_pack([first], None, pack, other_dates=others, networks=[open_features()], **origin)
    return FlightSpec("jam", pack, naip / f"{CAMERA_YEAR}.tif", None)


def report(world: str, specs: Sequence[FlightSpec], methods: Sequence[str], jobs: int) -> None:
    """One row a flight and method, the methods side by side; then one row a method."""
    todo = [replace(spec, method=method) for spec in specs for method in methods]
    made: dict[str, list[Flown]] = {method: [] for method in methods}
    print(f"\n{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        alone = [text for text in pool.map(without_daemon, specs) for _ in methods]
        for spec, without, flown in zip(todo, alone, pool.map(fly_one, todo), strict=True):
            made[spec.method].append(flown)
            print(row(world, spec, flown.result, without), flush=True)
    print(f"\n{GAIN_HEADER}\n|{'---|' * (GAIN_HEADER.count('|') - 1)}")
    for method, flights in made.items():
        print(gain_row(world, method, flights), flush=True)


def fly_one(spec: FlightSpec) -> Flown:
    """One flight, on one thread."""
    cv2.setNumThreads(1)
    flown = fly_spec(spec)
    record = flown.record
    took = np.array([answer.elapsed_ms for answer in (*record.fixes, *record.refusals)])
    relied_on = (record.t_s >= find_scenario(spec.scenario).fault_start_s) & record.injected
    return Flown(result_of(flown, spec.method), fix_errors_m(record), record.error_m[relied_on], took)


def row(world: str, spec: FlightSpec, result: dict[str, Any], without: str) -> str:
    """A flight as a row of the table."""
    expected = {item["name"]: str(item["value"]).removesuffix(" m").removesuffix(" s") for item in result["expected"]}
    cells = [
        world,
        result["scenario"] + (f", low ({spec.height_m:.0f} m)" if spec.height_m else ""),
        f"{result['dialect']} {result['vehicle']}",
        result["method"],
        "yes" if result["passed"] else "no: " + ", ".join(i["name"] for i in result["expected"] if not i["passed"]),
        expected["median error without GNSS"],
        expected["largest error without GNSS"],
        expected["GNSS declared bad after"],
        f"{result['pulled_m']:.1f}",
        result["n_fixes"],
        result["n_no_fix"],
        f"{100 * result['availability']:.1f} %",
        result["hmi"],
        result["nees"],
        result["failsafe"] or "none",
        without,
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def gain_row(world: str, method: str, flights: Sequence[Flown]) -> str:
    """All flights of a method in one row; positions are those sent since the first fault, fixes all."""
    results = [each.result for each in flights]
    fixes = sum(result["n_fixes"] for result in results)
    answers = fixes + sum(result["n_no_fix"] for result in results)
    cells = [
        world,
        method,
        f"{sum(result['passed'] for result in results)} of {len(results)}",
        str(answers),
        f"{100 * fixes / max(1, answers):.1f} %",
        *_spread([each.fix_off_m for each in flights]),
        *_spread([each.off_m for each in flights]),
        f"{100 * np.mean([result['availability'] for result in results]):.1f} %",
        str(sum(result["hmi"] for result in results)),
        f"{np.median(np.concatenate([each.took_ms for each in flights])):.0f}",
    ]
    return "| " + " | ".join(cells) + " |"


def _spread(parts: Sequence[FloatArray]) -> tuple[str, str]:
    values = np.concatenate(list(parts))
    values = values[np.isfinite(values)]
    return (f"{np.median(values):.2f}", f"{np.percentile(values, 95):.2f}") if len(values) else ("–", "–")


def without_daemon(spec: FlightSpec) -> str:
    """How the same flight ends without the daemon."""
    log = fly_spec(replace(spec, with_daemon=False)).log
    off_m = log.truth[-1].off_m
    return f"{'no position' if off_m is None else f'{off_m:.0f} m off'}, {log.failsafe or 'no failsafe'}"


def naip_report(spec: FlightSpec, path: Path) -> None:
    """The HTML report of one flight over NAIP, without the imagery: it is not the project's to pass on."""
    flown, baseline = fly_spec(spec), fly_spec(replace(spec, with_daemon=False))
    write_flight_report(
        flown.record,
        path,
        title=f"GNSS loss over NAIP: map of {MAP_YEAR}, camera of {CAMERA_YEAR}, {spec.dialect} {spec.vehicle}, {spec.method}",
        checks=flown.checks,
        baseline=baseline.record,
        alert_limit_m=ALERT_LIMIT_M,
        gnss_faults_s=fault_intervals(find_scenario(spec.scenario)),
        notes=[
            "The map has 5 m per pixel and the two years are misregistered by about half a pixel.",
            f"{flown.summary['n_fixes']} fixes.",
        ],
    )


if __name__ == "__main__":
    main()
