"""Every scenario of the library, flown and judged: one table.

    python -m benchmarks.scenarios [--only NAME ...] [--dialects ardupilot px4] [--vehicles copter plane] [--seeds 1]
                                   [--size 1000] [--width 640] [--rate 4] [--method deep] [--lens fisheye_150]
                                   [--rows FILE] [--write docs/scenarios.md [--no-flights]]

Flights are those of `visloc sim`, over the procedural world of a given size. With --write the tables in that file are replaced.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from benchmarks.lenses import LENSES, lens
from benchmarks.pages.scenario_page import LIMITS, RESULTS, limits_table, replaced, table
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.evaluate.closed_loop import FlightWorld, FlownScenario, fly
from visloc_companion.evaluate.expected import error_over_level, relied_upon, taken_fixes
from visloc_companion.evaluate.metrics import error_figures
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import ProceduralWorld, procedural_world, scene_on
from visloc_companion.sim.land.season import Date
from visloc_companion.sim.scenarios import SCENARIOS
from visloc_companion.sim.scene import Scene
from visloc_companion.sim.setup import FlightSetup, VehicleKind
from visloc_companion.types import AutopilotKind

COLUMNS = (
    *("scenario", "flown as", "median m", "largest m", "error / level", "misleading", "HMI", "furthest fix m", "fixes of frames"),
    *("modes without GNSS", "GNSS bad after s", "verdict at the end", "as expected", "CPU s"),
)
WORLD_SEED = 1


@dataclass(frozen=True, slots=True)
class Row:
    """A flight and what it took."""

    flown: FlownScenario
    cpu_s: float

    @property
    def cells(self) -> list[str]:
        """One a column."""
        flown, record, setup = self.flown, self.flown.record, self.flown.setup
        start_s = setup.scenario.fault_start_s
        relied_on = relied_upon(record, start_s)
        error, level = error_figures(record, relied_on), error_over_level(record, relied_on)
        misleading = int(np.sum(record.error_m[relied_on] > record.protection_level_m[relied_on]))
        wrong = [off for fix, off in taken_fixes(flown.log, record) if fix.t_s >= start_s]
        detected = flown.summary["gnss"]["detected_at_s"]
        failed = [f"{check.name}: {check.value} ({check.limit})" for check in flown.checks if not check.passed]
        modes = [mode for t_s, mode in record.changes(record.modes) if t_s >= start_s]
        return [
            setup.scenario.name,
            f"{setup.kind.value} {setup.vehicle}, seed {setup.seed}, {self._camera}, {setup.scenario.frame_rate_hz:.2g}/s",
            _number(error["median"]),
            _number(error["max"]),
            _number(level, 2),
            f"{misleading} of {int(relied_on.sum())}",
            str(flown.summary["hmi"]),
            _number(max(wrong, default=None)),
            f"{len(record.fixes)} of {record.n_requests}",
            _in_short(modes),
            "–" if detected is None else f"{detected - start_s:.1f}",
            ", ".join(sorted(set(record.verdicts[-10:]))),
            "yes" if flown.passed else "NO: " + "; ".join(failed),
            f"{self.cpu_s:.0f}",
        ]

    @property
    def _camera(self) -> str:
        model = self.flown.setup.camera_model()
        return (
            f"{model.width_px} px"
            if model.distortion_model == "brown_conrady"
            else f"{model.distortion_model} {model.fx_px:.0f} px"
        )


def _number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _in_short(modes: list[str], most: int = 5) -> str:
    shown = ", ".join(modes[:most]) or "unchanged"
    return shown if len(modes) <= most else f"{shown}, … ({len(modes)} changes)"


class Worlds:
    """The procedural world of a seed on the dates that were asked for, each loaded once."""

    def __init__(self, size_m: float, seed: int = WORLD_SEED) -> None:
        self._files: ProceduralWorld = procedural_world(seed, size_m=size_m)
        self._size_m, self._seed, self._reference = size_m, seed, PackMap.open(self._files.pack, verify_hashes=False)
        self._scenes: dict[Date, Scene] = {}

    def on(self, date: Date) -> FlightWorld:
        """The map, and what the camera sees on a date."""
        if date not in self._scenes:
            self._scenes[date] = Scene.load(*scene_on(self._files, date, self._seed, size_m=self._size_m))
        return FlightWorld(self._files.pack, self._reference, self._scenes[date])


def fly_all(options: argparse.Namespace) -> list[list[str]]:
    """Fly what was asked for; print each row, and add it to the file that was named."""
    worlds, rows = Worlds(options.size), []
    print(table(COLUMNS, []), flush=True)
    cases = product(options.only or SCENARIOS, options.dialects, options.vehicles, options.seeds)
    for name, dialect, vehicle, seed in cases:
        scenario = SCENARIOS[name]
        scenario = replace(scenario, frame_rate_hz=min(scenario.frame_rate_hz, options.rate))
        world, kind, which = worlds.on(scenario.date), AutopilotKind(dialect), cast("VehicleKind", vehicle)
        began = time.process_time()
        camera = lens(options.lens, options.width) if options.lens else None
        setup = FlightSetup(scenario, world.area(), kind, which, seed, width_px=options.width, camera=camera)
        flown = fly(setup, world, method=options.method)
        rows.append(Row(flown, time.process_time() - began).cells)
        print(f"| {' | '.join(rows[-1])} |", flush=True)
        if options.rows is not None:
            with options.rows.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    return rows


def written(page: str, rows: list[list[str]]) -> str:
    """A page with its tables replaced; of rows of the same flight the last counts."""
    latest = {tuple(row[:2]): row for row in rows}
    ordered = sorted(latest.values(), key=lambda row: (list(SCENARIOS).index(row[0]), row[1]))
    passed = sum(row[COLUMNS.index("as expected")] == "yes" for row in ordered)
    summary = f"{passed} of {len(ordered)} flights showed what is expected (`python -m benchmarks.scenarios`)."
    results = f"{summary}\n\n{table(COLUMNS, ordered)}"
    return replaced(replaced(page, LIMITS, limits_table()), RESULTS, results)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(SCENARIOS), default=[])
    parser.add_argument("--dialects", nargs="+", choices=["ardupilot", "px4"], default=["ardupilot", "px4"])
    parser.add_argument("--vehicles", nargs="+", choices=["copter", "plane"], default=["copter"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--size", type=float, default=1000.0)
    parser.add_argument("--width", type=int, default=640, help="columns of the camera")
    parser.add_argument("--lens", choices=LENSES, help="in place of the pinhole camera of 60 degrees")
    parser.add_argument("--rate", type=float, default=4.0, help="frames a second, at most")
    parser.add_argument("--method", default=DEFAULT_METHOD)
    parser.add_argument("--rows", type=Path, help="add the rows to this file; --write takes them from it")
    parser.add_argument("--no-flights", action="store_true", help="only --write")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = [] if options.no_flights else fly_all(options)
    if options.write is not None:
        if options.rows is not None:
            rows = [json.loads(line) for line in options.rows.read_text(encoding="utf-8").splitlines()]
        options.write.write_text(written(options.write.read_text(encoding="utf-8"), rows), encoding="utf-8")


if __name__ == "__main__":
    main()
