"""Closed-loop flights: the scenarios over the procedural world, and GNSS loss over NAIP of two years.

    python -m benchmarks.flights [--jobs N] [--worlds procedural naip] [--naip-report FILE]

Prints a markdown table. The camera's date is never the map's. Needs ../shared/data/naip for the second part.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.cases import SHARED
from visloc_companion.evaluate.campaign import FlightSpec, campaign_specs, find_scenario, fly_spec, run_campaign
from visloc_companion.evaluate.closed_loop import fault_intervals
from visloc_companion.evaluate.report import write_flight_report
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.world import procedural_world

MAP_YEAR, CAMERA_YEAR = "20180716", "20160816"
NAIP_FLIGHTS = (("demo", "copter"), ("jam", "copter"), ("slow_drag", "copter"), ("jam", "plane"))
HEADER = (
    "| world | scenario | autopilot | passed | without GNSS: median m | max m | GNSS bad after s | pulled m | fixes | refused | "
    "HMI | NEES | failsafe | without the daemon |"
)


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--worlds", nargs="+", default=["procedural", "naip"], choices=["procedural", "naip"])
    parser.add_argument("--naip-report", type=Path)
    options = parser.parse_args()
    print(HEADER)
    print("|" + "---|" * 14)
    if "procedural" in options.worlds:
        world = procedural_world(1)
        template = FlightSpec("jam", world.pack, world.flight_ortho, world.flight_dsm)
        report("procedural, 0.5 m/px", campaign_specs("scenarios", template), options.jobs)
    naip = SHARED / "data" / "naip"
    if "naip" in options.worlds and naip.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            pack = Path(folder) / "pack"
            build_pack([naip / f"{MAP_YEAR}.tif"], None, pack, source="USDA NAIP", licence="public domain")
            base = FlightSpec("jam", pack, naip / f"{CAMERA_YEAR}.tif", None)
            report("NAIP, 5 m/px", [replace(base, scenario=s, vehicle=v) for s, v in NAIP_FLIGHTS], options.jobs)
            if options.naip_report:
                naip_report(replace(base, scenario="demo"), options.naip_report)


def report(world: str, specs: list[FlightSpec], jobs: int) -> None:
    """One row a flight."""
    outcome = run_campaign(specs, jobs, lambda result: None)
    for spec, result in zip(specs, outcome["flights"], strict=True):
        print(row(world, result, without_daemon(spec)), flush=True)
    print(f"| {world} | all | | {outcome['totals']['passed']} of {len(specs)} |" + " |" * 10, flush=True)


def row(world: str, result: dict[str, Any], without: str) -> str:
    """A flight as a row of the table."""
    expected = {item["name"]: str(item["value"]).removesuffix(" m").removesuffix(" s") for item in result["expected"]}
    cells = [
        world,
        result["scenario"],
        f"{result['dialect']} {result['vehicle']}",
        "yes" if result["passed"] else "no: " + ", ".join(i["name"] for i in result["expected"] if not i["passed"]),
        expected["median error without GNSS"],
        expected["largest error without GNSS"],
        expected["GNSS declared bad after"],
        f"{result['pulled_m']:.1f}",
        result["n_fixes"],
        result["n_no_fix"],
        result["hmi"],
        result["nees"],
        result["failsafe"] or "none",
        without,
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def without_daemon(spec: FlightSpec) -> str:
    """How the same flight ends without the daemon."""
    log = fly_spec(replace(spec, with_daemon=False)).log
    off_m = log.truth[-1].off_m
    return f"{'no position' if off_m is None else f'{off_m:.0f} m off'}, {log.failsafe or 'no failsafe'}"


def naip_report(spec: FlightSpec, path: Path) -> None:
    """The HTML report of one flight over NAIP, without the imagery: it is not the project's to pass on."""
    flown, baseline = fly_spec(spec), fly_spec(replace(spec, with_daemon=False))
    scenario = find_scenario(spec.scenario)
    write_flight_report(
        flown.record,
        path,
        title=f"GNSS loss over NAIP: map of {MAP_YEAR}, camera of {CAMERA_YEAR}, {spec.dialect} {spec.vehicle}",
        checks=flown.checks,
        baseline=baseline.record,
        gnss_faults_s=fault_intervals(scenario),
        notes=[
            "The map has 5 m per pixel and the two years are misregistered by about half a pixel.",
            f"{flown.summary['n_fixes']} fixes.",
        ],
    )


if __name__ == "__main__":
    main()
