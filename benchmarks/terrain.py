"""Terrain-referenced navigation over 218 km: `python -m benchmarks.terrain [--seeds N] [--dem FILE]`.

Each seed is a world of its own (benchmarks/terrain_flights/terrain_world.py) and a flight over it; with --dem the ground is that
model (GeoTIFF, metres). Every stretch of soundings counts, over lakes and plains as well, except where nothing came back at all.
Matched: accepted and right (off by at most 20 m and 5 m in height, the published bounds). The constants are fitted on seeds 100
and 101 (`benchmarks/terrain_fit.py`); seeds here begin at 1.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks import terrain_converge
from benchmarks.terrain_flights.terrain_flight import DRIFTS, make_flight
from benchmarks.terrain_flights.terrain_run import Judged, Outcome, Run
from benchmarks.terrain_flights.terrain_world import CLASSES, World, elevation_model, make_world
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.localise.terrain.base import Kind, TerrainFix
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.types import FloatArray

RIGHT_M, RIGHT_H_M = 20.0, 5.0
SENSORS = {"scanner": (Kind.PATCH, 0.3), "stereo": (Kind.PATCH, 1.5), "altimeter": (Kind.PROFILE, 0.5)}


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table: what was flown, over which cells."""

    sensor: str
    drift: str
    cell_m: float


ROWS = (
    Row("scanner", "tactical", 20.0),
    Row("scanner", "mems", 20.0),
    Row("scanner", "tactical", 10.0),
    Row("scanner", "tactical", 30.0),
    Row("scanner", "mems", 30.0),
    Row("stereo", "tactical", 20.0),
    Row("altimeter", "tactical", 20.0),
    Row("altimeter", "mems", 20.0),
)
HEADER = (
    "| sensor | dead reckoning | cell m | n | matched | refused | accepted, wrong | lateral m 50/95/max | height m 50/95/max | "
    "amid the stretch 50/95/max | rms(e/s) N, E, height, amid | in 95 % ellipse | flight: lateral m 50/95 | height m 50/95 | "
    "amid the stretch 50/95 | rms(e/s) N, E, height, amid | ms CPU 50/95 |"
)

BY_CLASS = "| patches over | n | matched | refused | accepted, wrong | lateral m 95 | length m |"


def main() -> None:
    """Fly, match, print."""
    args = _arguments()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    everything: list[Judged] = []
    for wanted in args.rows or range(len(ROWS)):
        row = ROWS[wanted]
        outcomes = [_flown(row, seed, args.dem, args.forest) for seed in seeds]
        print(line(row, outcomes), flush=True)
        if row.sensor != "altimeter":
            everything += [judged for outcome in outcomes for judged in outcome.judged]
    if everything:
        print(f"\n{BY_CLASS}\n|{'---|' * BY_CLASS.count(' | ')}---|")
        print("\n".join(by_class(everything)))
        print(
            "\nrefused:",
            dict(Counter(str(j.answer.reason) for j in everything if not isinstance(j.answer, TerrainFix))),
            flush=True,
        )
    if not args.no_convergence:
        print()
        terrain_converge.report(seeds, args.dem)


@lru_cache(maxsize=4)
def _world(seed: int, dem: Path | None, forest: float) -> World:
    return make_world(seed, dem, forest)


def _flown(row: Row, seed: int, dem: Path | None, forest: float) -> Outcome:
    world = _world(seed, dem, forest)
    kind, sigma = SENSORS[row.sensor]
    elevation = elevation_model(world, row.cell_m, seed)
    return Run(world, elevation, make_flight(world, DRIFTS[row.drift], seed), seed, kind, sigma).fly(TerrainSettings())


def is_right(judged: Judged) -> bool:
    """Accepted, and within the published bounds."""
    return (
        isinstance(judged.answer, TerrainFix)
        and float(np.hypot(*judged.error_ne_m)) <= RIGHT_M
        and abs(judged.error_h_m) <= RIGHT_H_M
    )


def line(row: Row, outcomes: list[Outcome]) -> str:
    """One row of the table over all seeds."""
    judged = [j for outcome in outcomes for j in outcome.judged]
    fixes = [j for j in judged if isinstance(j.answer, TerrainFix)]
    errors = np.array([[*j.error_ne_m, j.error_h_m, j.error_h_then_m] for j in fixes])
    claims = [(*np.sqrt(np.diag(np.array(a.cov_ne_m2))), a.sigma_h_m, a.sigma_h_then_m) for a in (j.answer for j in fixes)]
    sigmas = np.array(claims)
    inside = [float(j.error_ne_m @ np.linalg.solve(np.array(j.answer.cov_ne_m2), j.error_ne_m)) <= CHI2_95 for j in fixes]
    flown, believed = (
        np.concatenate([np.array(getattr(o, name)) for o in outcomes]) for name in ("filter_error", "filter_sigma")
    )
    right = sum(map(is_right, judged))
    cells = [
        *(row.sensor, row.drift, f"{row.cell_m:.0f}", str(len(judged)), _percent(right / len(judged))),
        *(_percent(1 - len(fixes) / len(judged)), str(len(fixes) - right)),
        *(_quantiles(np.hypot(errors[:, 0], errors[:, 1]), 50, 95, 100), _quantiles(np.abs(errors[:, 2]), 50, 95, 100)),
        *(_quantiles(np.abs(errors[:, 3]), 50, 95, 100), _rms(errors / sigmas), _percent(float(np.mean(inside)))),
        *(_quantiles(np.hypot(flown[:, 0], flown[:, 1]), 50, 95), _quantiles(np.abs(flown[:, 2]), 50, 95)),
        *(
            _quantiles(np.abs(flown[:, 3]), 50, 95),
            _rms(flown / believed),
            _quantiles(np.array([j.cpu_ms for j in judged]), 50, 95),
        ),
    ]
    return f"| {' | '.join(cells)} |"


def by_class(judged: list[Judged]) -> Iterator[str]:
    """One row for each class of ground."""
    for name in CLASSES:
        of = [j for j in judged if j.region == name]
        fixes = [j for j in of if isinstance(j.answer, TerrainFix)]
        if not fixes:
            continue
        right = sum(map(is_right, of))
        lateral = _quantiles(np.array([np.hypot(*j.error_ne_m) for j in fixes]), 95)
        length = f"{np.mean([j.length_m for j in of]):.0f}"
        cells = [name, str(len(of)), _percent(right / len(of)), _percent(1 - len(fixes) / len(of)), str(len(fixes) - right)]
        yield f"| {' | '.join([*cells, lateral, length])} |"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _quantiles(values: FloatArray, *percent: float) -> str:
    return " / ".join(f"{v:.1f}" for v in np.percentile(values, percent))


def _rms(ratios: FloatArray) -> str:
    return ", ".join(f"{v:.2f}" for v in np.sqrt(np.mean(np.square(ratios), axis=0)))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--dem", type=Path, help="a real elevation model, GeoTIFF with a CRS in metres")
    parser.add_argument("--forest", type=float, default=1.0, help="so many times as much forest")
    parser.add_argument("--rows", type=int, nargs="*", help="numbers of the rows to fly (default: all)")
    parser.add_argument("--no-convergence", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    main()
