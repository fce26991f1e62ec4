"""Kidnapped starts: a vehicle somewhere over a map of two dates, without GNSS and without a first position.

    python -m benchmarks.kidnapped [--worlds procedural=20 naip=20 stranger=5 water=5 naip-off=5] [--seed 101] [--first 0]
        [--seconds 60] [--quiet-ms MS] [--folder FOLDER] [--rows FILE] [--json FILE]

procedural: the landscape of a seed, 4 x 4 km, 120 m above the ground, 10 m/s; the camera sees it five years after the map.
naip: 5 m/px, 2.4 x 3.6 km, all of it searched, the vehicle over rows >= 400; 415 m above the ground (a footprint of 96 px),
25 m/s, map and camera of different years (needs ../shared/data/naip).
Without a right place: stranger, the procedural map, but the camera is over the landscape of another seed; water, the same, and
the camera sees waves only; naip-off, the flights of naip with a map of the rows < 400 only.

A trial is right when the navigator is anchored within 30 s and not far off (15 m; naip 25 m), and wrong when it is anchored far
off at any time of the flight's 60 s, or at all where there is no right place. With --rows each trial is added to that file, and
those that it holds are not flown again: a run that was ended goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.flown.kidnapped_flight import KidnappedFlight, Outcome
from benchmarks.machine.pace import Pace
from benchmarks.worlds.kidnapped_worlds import ALLOWED_M, IMPOSSIBLE, SOLVABLE, WITHIN_S, Course, courses_of, way_of
from visloc_companion.config import DEFAULT_METHOD
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice

RULE_OF_THREE = 3.0
"""None of n was wrong: then fewer than 3/n are, with 95 % confidence (Hanley and Lippman-Hand 1983)."""


def main(argv: Sequence[str] | None = None) -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", default=["procedural=20", "naip=20"], metavar="WORLD=TRIALS")
    parser.add_argument("--seed", type=int, default=101, help="of the procedural landscape; below 100 is for training")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial: another one draws other flights")
    parser.add_argument("--seconds", type=float, default=60.0, help="of a flight that does not find its place")
    parser.add_argument("--folder", type=Path, help="where procedural worlds are kept")
    parser.add_argument(
        "--quiet-ms", type=float, help="of the work of pace.py on the computer that times are for (else this one)"
    )
    parser.add_argument("--rows", type=Path, help="where trials are kept; those that are there are not flown again")
    parser.add_argument("--json", type=Path, help="written anew after each world")
    options = parser.parse_args(argv)
    counts = dict(asked(text, parser) for text in options.worlds)
    cv2.setNumThreads(1)
    pace = Pace(options.quiet_ms / 1e3 if options.quiet_ms else None)
    results: dict[str, Any] = {}
    kept = Kept(options.rows, options.seed)
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}")
    with tempfile.TemporaryDirectory() as scratch:
        for world, trials in counts.items():
            numbers = range(options.first, options.first + trials)
            if any(kept.get(world, number) is None for number in numbers):
                courses = courses_of(world, options.seed, options.folder, Path(scratch))
            outcomes = []
            for number in numbers:
                outcome = kept.get(world, number)
                if outcome is None:
                    outcome = kept.add(world, number, fly_one(courses[number % len(courses)], number, options.seconds, pace))
                    print(world, number, outcome.line(), file=sys.stderr, flush=True)
                outcomes.append(outcome)
            results[world] = summary(outcomes, ALLOWED_M.get(world))
            if options.json:
                options.json.write_text(json.dumps({"schema": 2, "results": results}, indent=1), encoding="utf-8")
            print(row(world, results[world]), flush=True)


class Kept:
    """Trials that were flown, in a file of a JSON object a line (None: in no file); NAIP's do not depend on the seed."""

    def __init__(self, path: Path | None, seed: int) -> None:
        self._path, self._seed = path, seed
        lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.exists() else []
        rows = [json.loads(line) for line in lines]
        self._flown = {(row["world"], row["seed"], row["number"]): Outcome(**row["outcome"]) for row in rows}

    def get(self, world: str, number: int) -> Outcome | None:
        """A trial, or None where it has not been flown."""
        return self._flown.get((world, self._seed_of(world), number))

    def add(self, world: str, number: int, outcome: Outcome) -> Outcome:
        """Keep a trial."""
        if self._path is not None:
            about = {"world": world, "seed": self._seed_of(world), "number": number, "outcome": asdict(outcome)}
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(about) + "\n")
        return outcome

    def _seed_of(self, world: str) -> int:
        return 0 if "naip" in world else self._seed


def asked(text: str, parser: argparse.ArgumentParser) -> tuple[str, int]:
    """A world and how many trials."""
    world, _, trials = text.partition("=")
    if world not in (*SOLVABLE, *IMPOSSIBLE) or not (trials or "20").isdigit() or trials == "0":
        parser.error(f"{text!r} is no world with a number of trials, as naip=20; worlds: {', '.join(SOLVABLE + IMPOSSIBLE)}")
    return world, int(trials or 20)


def fly_one(course: Course, number: int, seconds: float, pace: Pace) -> Outcome:
    """The flight of a number."""
    features = open_features_for(DEFAULT_METHOD, NetworkChoice(threads=1))
    localiser = make_localiser(DEFAULT_METHOD, course.model, features=features, max_probability_wrong=0.05)
    way = way_of(course, np.random.default_rng(number))
    far_m = course.height_m
    flight = KidnappedFlight(way, course.camera(), course.model, localiser, course.pack, number, far_m, pace)
    return flight.fly(seconds)


def summary(outcomes: Sequence[Outcome], allowed_m: float | None) -> dict[str, Any]:
    """Figures of one world's flights; `allowed_m` None: there is no right place, and refused is right."""
    anchored = [o for o in outcomes if o.off_m is not None and o.anchored_s is not None]
    right = [o for o in anchored if allowed_m is not None and o.off_m is not None and o.off_m <= allowed_m]
    times, off = (np.array([getattr(o, name) for o in right], dtype=np.float64) for name in ("anchored_s", "off_m"))
    tiles, tests = (np.array([ms for o in outcomes for ms in getattr(o, name)]) for name in ("tile_ms", "test_ms"))
    return {
        "trials": len(outcomes),
        "right_within_30_s": sum((o.anchored_s or 0.0) <= WITHIN_S for o in right),
        "right": len(right),
        "refused": len(outcomes) - len(anchored),
        "wrong": len(anchored) - len(right),
        "wrong_at_most": RULE_OF_THREE / len(outcomes) if len(anchored) == len(right) else None,
        "tests_elsewhere": sum(o.elsewhere for o in outcomes),
        "mistaken": sum(o.mistaken for o in outcomes),
        "false_listed": sum(o.false_listed for o in outcomes),
        "anchored_s": {"median": _percentile(times, 50), "p95": _percentile(times, 95)},
        "off_m": {"median": _percentile(off, 50), "max": _percentile(off, 100)},
        "cpu_ms": {"tile": _percentile(tiles, 50), "tile_p95": _percentile(tiles, 95), "test": _percentile(tests, 50)},
        "tiles": len(tiles),
        "each": [[o.anchored_s, o.off_m, len(o.tile_ms), sum(o.tile_ms), len(o.test_ms), sum(o.test_ms)] for o in outcomes],
        "slower": _percentile(np.array([x for o in outcomes for x in o.slower]), 50),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _percentile(values: Any, share: float) -> float | None:
    return float(np.percentile(values, share)) if len(values) else None


def row(world: str, figures: dict[str, Any]) -> str:
    """A world as a row of the table."""
    times, off, cpu = figures["anchored_s"], figures["off_m"], figures["cpu_ms"]
    names = ("trials", "right_within_30_s", "right", "refused", "wrong")
    cells = [
        world,
        *(str(figures[name]) for name in names),
        f"{figures['mistaken']} of {figures['tests_elsewhere']}",
        f"{figures['false_listed']} of {figures['tiles']}",
        *(_text(value, 1) for value in (times["median"], times["p95"], off["median"], off["max"])),
        *(_text(value, 0) for value in (cpu["tile"], cpu["tile_p95"], cpu["test"], figures["peak_memory_mb"])),
    ]
    return "| " + " | ".join(cells) + " |"


def _text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


HEADER = (
    "| world | trials | right within 30 s | right within 60 s | refused | wrong | tests elsewhere mistaken | "
    "tiles that gave a false fix | found after s: median | 95 % | off by m: median | max | CPU ms a tile: median | 95 % | "
    "CPU ms a test | peak memory MB |"
)

if __name__ == "__main__":
    main()
