"""The real daemon with the real autopilots' own simulators: `python -m benchmarks.autopilots [--simulators ...] [--flights ...]`.

Needs the programs (`VISLOC_ARDUCOPTER`, `VISLOC_ARDUPLANE`, `VISLOC_PX4`, or on PATH); those that are missing are left out and
named. Every flight runs in a process and a network namespace of its own, at `--speed` times real time; the daemon lives by the
simulator's time. Fixes are the simulator's truth with white noise of 0.7 m per axis, 4 a second, 250 ms late: tested are
autopilot, link, encoder and filter, not the matching of images. `--json FILE` writes the figures, `--keep FOLDER` keeps the
journals and the autopilots' logs.

Beside each flight stands the built-in autopilot's on the same circuit with the same fixes; it does not stop at corners.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from benchmarks.autopilots_built_in import built_in_p95_m
from visloc_companion.errors import ConfigError, VislocError
from visloc_companion.evaluate.real_flight import RealFigures, checks, real_figures
from visloc_companion.sim.real.apart import fly_apart
from visloc_companion.sim.real.programs import Simulator, find_program
from visloc_companion.sim.real.scenarios import NAMES, real_scenario

HEADER = (
    "| simulator | flight | on vision s | 95 % m | largest m | on GNSS 95 % m | off at the end m | velocity rms m/s | "
    "rejected | failsafes in the air | wrong source s | pulled m | built-in 95 % m | passed |"
)


def main() -> None:
    """Fly, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulators", nargs="+", type=Simulator, default=list(Simulator), metavar="NAME")
    parser.add_argument("--flights", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--speed", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--skip-built-in", action="store_true", help="leave the built-in autopilot's column empty")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    print(HEADER)
    print("|" + "---|" * (HEADER.count("|") - 1))
    results, versions = [], set()
    for simulator in args.simulators:
        try:
            find_program(simulator)
        except ConfigError as why:
            print(f"{simulator} is left out: {why}")
            continue
        for name in args.flights:
            keep = None if args.keep is None else args.keep / f"{simulator}-{name}-{args.seed}"
            result = _one(simulator, name, args, keep)
            results.append(result)
            versions.add(f"{simulator}: {result.get('version', '')}")
            if args.json is not None:
                args.json.write_text(json.dumps(results, indent=1), encoding="utf-8")
    print("; ".join(sorted(versions)))


def _one(simulator: Simulator, name: str, args: argparse.Namespace, keep: Path | None) -> dict[str, object]:
    try:
        scenario = real_scenario(name, simulator, args.seed)
        log = fly_apart(simulator, scenario, speed=args.speed, keep=keep)
    except VislocError as why:
        print(f"| {simulator} | {name} | not flown: {why} |")
        return {"simulator": simulator, "flight": name, "error": str(why)}
    figures = real_figures(log, scenario)
    passed = all(check.passed for check in checks(figures, scenario, simulator)) if scenario.with_daemon else None
    built_in_m = built_in_p95_m(scenario, simulator) if scenario.with_daemon and not args.skip_built_in else None
    print(_row(simulator, name, figures, built_in_m, passed), flush=True)
    return {
        "simulator": simulator,
        "flight": name,
        "version": log.version,
        "built_in_p95_m": built_in_m,
        "passed": passed,
        **asdict(figures),
        "marks": log.marks,
        "warnings": log.warnings,
    }


def _row(simulator: Simulator, name: str, figures: RealFigures, built_in_m: float | None, passed: bool | None) -> str:
    numbers = (figures.vision_s, figures.error_p95_m, figures.error_max_m, figures.gnss_p95_m, figures.end_error_m)
    verdict = {None: "nothing is asked", True: "yes", False: "no"}[passed]
    share = "" if figures.rejected_share is None else f"{figures.rejected_share:.1%}"
    cells = (
        simulator,
        name,
        *map(_number, numbers),
        _number(figures.velocity_rms_mps, 2),
        share,
        "; ".join(figures.failsafes) or "none",
        _number(figures.wrong_source_s),
        _number(figures.pulled_m),
        _number(built_in_m),
        verdict,
    )
    return f"| {' | '.join(cells)} |"


def _number(value: float | None, digits: int = 1) -> str:
    return "" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    main()
