"""How far the prior may be off: `python -m benchmarks.cloud_reach [--clouds CLOUDS WORK] [--n N] [--seeds S] [--errors 60 500]`.

The same sources and directions of error at every error (the half side of a square in which it is uniform), so that what is found
at the smallest error and not at a larger one is lost to the distance, not to the place.

`clouds`: sources of scenario A (N a place and level) in references of 1.8 km, at most two points a square metre, of their own and
of mirrored ones of other cases (benchmarks/cloud_sets/cloud_mosaic.py). `landscape`: the procedural landscape, two dates
(benchmarks/cloud_sets/cloud_landscape.py). Prints, for each error, the shares within 5 m and accepted, of the sources within 5 m
at the smallest error the share still within 5 m, how many of the accepted are wrong, the area under the ROC curve of
`probability_wrong`, the median error, CPU time and the process's peak of memory.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_sets.cloud_answers import answer_of
from benchmarks.cloud_sets.cloud_cases import BLANK, LEVELS, CloudCase, make, read
from benchmarks.cloud_sets.cloud_landscape import SOURCE_M, LandscapeWorld
from benchmarks.cloud_sets.cloud_mosaic import displaced, mosaic
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise.registration.pair import SIGMAS
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, make_registration

Array = NDArray[np.float64]
Scene = Callable[[float], CloudCase]
"""Of an error of the prior, metres."""
HEADER = (
    "| scenes | prior error m | n | < 5 m % | of those at the smallest error % | accepted % | accepted, wrong | AUC "
    "| median m | CPU s | peak MB |"
)


def main() -> None:
    """Make the scenes, register, print."""
    args = _arguments()
    print(f"{HEADER}\n|{'---|' * (HEADER.count('|') - 1)}", flush=True)
    scenes: list[tuple[str, list[Scene]]] = []
    if args.clouds:
        clouds, work = args.clouds
        for level in LEVELS:
            some = [s for seed in args.seeds for s in _of_clouds(clouds, work, level, args.n, seed, max(args.errors))]
            scenes.append((f"clouds, {level}", some))
    scenes.append(("landscape", [s for seed in args.seeds for s in _of_landscape(args.n_landscape, seed)]))
    for label, some in scenes:
        for line in rows(label, some, sorted(args.errors)):
            print(line, flush=True)


def rows(label: str, scenes: list[Scene], errors_m: list[float]) -> Iterator[str]:
    """A line for each error, the smallest first."""
    method = make_registration("height-search", 1.0)
    near: list[bool] = []
    for error_m in errors_m:
        found = [answer_of(method, scene(error_m)) for scene in scenes]
        right = [not a.wrong for a in found]
        near = near or right
        answered = [a for a in found if not a.reason]
        honest = reliability(np.array([a.probability_wrong for a in answered]), np.array([a.wrong for a in answered]))
        taken = [a for a in found if a.probability_wrong <= DEFAULT_MAX_PROBABILITY_WRONG]
        kept = [r for r, n in zip(right, near, strict=True) if n]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield (
            f"| {label} | {error_m:.0f} | {len(found)} | {100 * np.mean(right):.1f} | {100 * np.mean(kept) if kept else 0:.1f} "
            f"| {100 * len(taken) / len(found):.1f} | {sum(a.wrong for a in taken)} | {honest['separation']} "
            f"| {np.median([a.horizontal_m for a in found]):.2f} | {np.median([a.cpu_s for a in found]):.2f} | {peak:.0f} |"
        )


def _of_clouds(clouds: Path, work: Path, level: str, n: int, seed: int, most_m: float) -> list[Scene]:
    cases = [c for c in read(make(clouds, work / "real", level, n, seed), level) if c.cover not in BLANK]
    return [partial(_cloud_scene, cases, k, most_m, seed) for k, case in enumerate(cases) if case.scenario == "A"]


def _cloud_scene(cases: list[CloudCase], k: int, most_m: float, seed: int, error_m: float) -> CloudCase:
    case, rng = cases[k], np.random.default_rng([seed, k])
    assert case.T_true is not None
    off = rng.uniform(-1, 1, 2)
    true_m = (case.T_true[:3] @ [*case.source_m.mean(0), 1])[:2]
    half = SIGMAS * most_m / np.sqrt(3) + SOURCE_M
    return displaced(mosaic(case, cases, true_m - most_m * off, half, rng), error_m * off, error_m / np.sqrt(3))


def _of_landscape(n: int, seed: int) -> list[Scene]:
    world = LandscapeWorld.built(seed)
    return [partial(world.case, k) for k in range(n)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clouds", type=Path, nargs=2, metavar=("CLOUDS", "WORK"), help="as benchmarks.clouds takes them")
    parser.add_argument("--n", type=int, default=4, help="sources a place and level")
    parser.add_argument("--n-landscape", type=int, default=20)
    parser.add_argument("--seeds", "--seed", type=int, nargs="+", default=[3])
    parser.add_argument("--errors", type=float, nargs="+", default=[60.0, 100.0, 250.0, 500.0])
    return parser.parse_args()


if __name__ == "__main__":
    main()
