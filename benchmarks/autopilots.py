"""The real daemon with the real autopilots' own simulators: `python -m benchmarks.autopilots [--simulators ...] [--flights ...]`.

Needs the programs (`VISLOC_ARDUCOPTER`, `VISLOC_ARDUPLANE`, `VISLOC_PX4`, or on PATH); those that are missing are left out and
named. Every flight runs in a process and a network namespace of its own, at `--speed` times real time; the daemon lives by the
simulator's time. Fixes are the simulator's truth with white noise of 0.7 m per axis, 4 a second, 250 ms late, where the flight
says nothing else: tested are autopilot, link, encoder and filter, not the matching of images, which is flown in `rendered`.
Fixes come without odometry but in `rendered` flights and those whose name says it; each row says which (`odometry`).

Each flight becomes one row, a JSON file in `--rows`; rows that are there are not flown again (`--again` does), so the table may
be made little by little. A flight that the machine was too busy for is flown once more at half the speed. At the end the table
of all rows is printed; `--write` puts it into docs/autopilots.md. `--keep FOLDER` keeps journals, samples and the autopilots'
logs. Beside each flight stands the built-in autopilot's on the same circuit with the same fixes; it does not stop at corners.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

from benchmarks.autopilots_built_in import built_in_p95_m
from benchmarks.pages.autopilots_table import DOCS, ROWS, Row, read_rows, row_path, table, written
from visloc_companion.errors import ConfigError, VislocError
from visloc_companion.evaluate.real.real_flight import checks, real_figures
from visloc_companion.evaluate.real.real_world import over_its_world
from visloc_companion.sim.real.apart import fly_apart
from visloc_companion.sim.real.programs import Simulator, find_program
from visloc_companion.sim.real.scenarios import NAMES, cannot_fly, real_scenario


def main() -> None:
    """Fly what is missing, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulators", nargs="*", type=Simulator, default=list(Simulator), metavar="NAME")
    parser.add_argument("--flights", nargs="*", choices=NAMES, default=list(NAMES))
    parser.add_argument("--speed", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=Path, default=ROWS)
    parser.add_argument("--again", action="store_true", help="fly rows anew that are there")
    parser.add_argument("--skip-built-in", action="store_true", help="leave the built-in autopilot's column empty")
    parser.add_argument("--write", action="store_true", help="put the table into docs/autopilots.md")
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    args.rows.mkdir(parents=True, exist_ok=True)
    for simulator in args.simulators:
        try:
            find_program(simulator)
        except ConfigError as why:
            print(f"{simulator} is left out: {why}")
            continue
        for name in args.flights:
            path = row_path(args.rows, simulator, name, args.seed)
            if cannot_fly(name, simulator) or (path.exists() and not args.again):
                continue
            row = _flown(simulator, name, args, args.speed)
            if row.get("starved"):
                row = _flown(simulator, name, args, args.speed / 2)
            path.write_text(json.dumps(row, indent=1), encoding="utf-8")
            print(f"{simulator} {name}: {row.get('error') or row['error_p95_m']}", flush=True)
    rows = read_rows(args.rows)
    print(table(rows))
    if args.write:
        DOCS.write_text(written(DOCS.read_text(encoding="utf-8"), rows), encoding="utf-8")


def _flown(simulator: Simulator, name: str, args: argparse.Namespace, speed: float) -> Row:
    scenario = over_its_world(real_scenario(name, simulator, args.seed))
    row: Row = {"simulator": str(simulator), "flight": name, "seed": args.seed, "speed": speed, "commit": _commit()}
    keep = None if args.keep is None else args.keep / f"{simulator}-{name}-{args.seed}"
    if keep is not None:
        shutil.rmtree(keep, ignore_errors=True)  # the same flight's, flown before
    try:
        log = fly_apart(simulator, scenario, speed=speed, keep=keep)
    except VislocError as why:
        return {**row, "error": str(why)}
    figures = real_figures(log, scenario)
    judged = checks(figures, scenario, simulator) if scenario.with_daemon else []
    built_in_m = built_in_p95_m(scenario, simulator) if scenario.with_daemon and not args.skip_built_in else None
    return {
        **row,
        "version": f"{log.version} {log.build}".strip(),
        "built_in_p95_m": built_in_m,
        "missed": [f"{check.name}: {check.value}, asked {check.limit}" for check in judged if not check.passed],
        "judged": bool(judged),
        "odometry": scenario.with_daemon and scenario.with_odometry,
        "starved": figures.starved,
        **asdict(figures),
        "marks": log.marks,
        "warnings": log.warnings,
    }


def _commit() -> str:
    asked = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()


if __name__ == "__main__":
    main()
