"""How far the prior may be off: `python -m benchmarks.cloud_reach [--clouds CLOUDS WORK] [--n N] [--seed S] [--errors 60 500]`.

The same sources and directions of error at every error (the half side of a square in which it is uniform), so that what is found
at the smallest error and not at a larger one is lost to the distance, not to the place.

`clouds`: sources of scenario A (N a place and level) in references of 1.8 km, at most two points a square metre, of their own
and of mirrored ones of other cases (benchmarks/cloud_mosaic.py). `landscape`: the procedural landscape on its map's date (2 km,
a point a square metre); the source 67 m of it anywhere, in March five years later (leafless, fields divided anew, stands felled,
buildings new), 4 points a square metre, 0.2 m of noise. Heading errors up to 5 deg, tilt 0.5 deg, scale 2 %, height 5 m, all
uniform. Prints, for each error, the shares within 5 m and accepted, of the sources within 5 m at the smallest error the share
still within 5 m, the median error, CPU time and the process's peak of memory.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_answers import answer_of
from benchmarks.cloud_cases import LEVELS, CloudCase, make, read
from benchmarks.cloud_mosaic import displaced, mosaic
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.pair import SIGMAS
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, make_registration
from visloc_companion.localise.registration.similarity import turned, with_linear
from visloc_companion.sim.landscape import build_landscape

Array = NDArray[np.float64]
Scene = Callable[[float], CloudCase]
"""Of an error of the prior, metres."""
SIZE_M, GSD_M, SOURCE_M, NOISE_M = 2000.0, 1.0, 67.0, 0.2
HEADER = (
    "| scenes | prior error m | n | < 5 m % | of those at the smallest error % | accepted % | accepted, wrong | median m | CPU s "
    "| peak MB |"
)
YAW_DEG, TILT_DEG, SCALE, UP_M = 5.0, 0.5, 0.02, 5.0


def main() -> None:
    """Make the scenes, register, print."""
    args = _arguments()
    print(f"{HEADER}\n|{'---|' * 10}", flush=True)
    scenes: list[tuple[str, list[Scene]]] = []
    if args.clouds:
        for level in LEVELS:
            scenes.append((f"clouds, {level}", _of_clouds(*args.clouds, level, args.n, args.seed, max(args.errors))))
    scenes.append(("landscape", _of_landscape(args.n_landscape, args.seed)))
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
        taken = [a for a in found if a.probability_wrong <= DEFAULT_MAX_PROBABILITY_WRONG]
        kept = [r for r, n in zip(right, near, strict=True) if n]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield (
            f"| {label} | {error_m:.0f} | {len(found)} | {100 * np.mean(right):.1f} | {100 * np.mean(kept) if kept else 0:.1f} "
            f"| {100 * len(taken) / len(found):.1f} | {sum(a.wrong for a in taken)} "
            f"| {np.median([a.horizontal_m for a in found]):.2f} | {np.median([a.cpu_s for a in found]):.2f} | {peak:.0f} |"
        )


def _of_clouds(clouds: Path, work: Path, level: str, n: int, seed: int, most_m: float) -> list[Scene]:
    cases = [c for c in read(make(clouds, work / "real", level, n, seed), level) if c.cover not in ("water", "bare")]
    return [partial(_cloud_scene, cases, k, most_m, seed) for k, case in enumerate(cases) if case.scenario == "A"]


def _cloud_scene(cases: list[CloudCase], k: int, most_m: float, seed: int, error_m: float) -> CloudCase:
    case, rng = cases[k], np.random.default_rng([seed, k])
    assert case.T_true is not None
    off = rng.uniform(-1, 1, 2)
    true_m = (case.T_true[:3] @ [*case.source_m.mean(0), 1])[:2]
    half = SIGMAS * most_m / np.sqrt(3) + SOURCE_M
    return displaced(mosaic(case, cases, true_m - most_m * off, half, rng), error_m * off, error_m / np.sqrt(3))


def _of_landscape(n: int, seed: int) -> list[Scene]:
    old, new = (build_landscape(seed, date, SIZE_M, GSD_M).dsm_amsl_m for date in ("map", "flight"))
    reference = _points(old, np.random.default_rng(seed), np.zeros(2), SIZE_M - 4, 1.0, 0.05)
    return [partial(_landscape_scene, new, reference, seed, k) for k in range(n)]


def _landscape_scene(surface: NDArray[np.float32], reference: Array, seed: int, k: int, error_m: float) -> CloudCase:
    rng = np.random.default_rng([seed, k])
    place = rng.uniform(-1, 1, 2) * (SIZE_M / 2 - SOURCE_M)
    source = _points(surface, rng, place, SOURCE_M, 4.0, NOISE_M)
    yaw, tilt_x, tilt_y = np.radians(rng.uniform(-1, 1, 3) * [YAW_DEG, TILT_DEG, TILT_DEG])
    linear = (1 + rng.uniform(-SCALE, SCALE)) * turned(tilt_x, tilt_y, yaw)
    middle = np.append(place, source[:, 2].mean())
    lies = middle - np.append(error_m * rng.uniform(-1, 1, 2), rng.uniform(-UP_M, UP_M))
    T = with_linear(linear, lies, middle)
    moved = (source - T[:3, 3]) @ np.linalg.inv(linear).T
    sigmas = np.array([error_m, UP_M, np.radians(YAW_DEG), np.radians(TILT_DEG), SCALE]) / np.sqrt(3)
    return CloudCase(f"{k}", "landscape", "reach", "years", moved, reference, RegistrationPrior(*sigmas), T)


def _points(
    surface: NDArray[np.float32], rng: np.random.Generator, place: Array, side_m: float, per_m2: float, noise_m: float
) -> Array:
    """Points at random on a square of the surface; its middle is (0, 0), rows run south."""
    xy = place + rng.uniform(-side_m / 2, side_m / 2, (int(per_m2 * side_m**2), 2))
    pixel = (np.column_stack([xy[:, 0], -xy[:, 1]]) + SIZE_M / 2) / GSD_M - 0.5
    parts = np.array_split(pixel.astype(np.float32), len(pixel) // 20_000 + 1)
    z = np.concatenate([cv2.remap(surface, p[None, :, 0], p[None, :, 1], cv2.INTER_LINEAR)[0] for p in parts])
    return np.column_stack([xy, z + rng.normal(0, noise_m, len(z))])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clouds", type=Path, nargs=2, metavar=("CLOUDS", "WORK"), help="as benchmarks.clouds takes them")
    parser.add_argument("--n", type=int, default=4, help="sources a place and level")
    parser.add_argument("--n-landscape", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--errors", type=float, nargs="+", default=[60.0, 100.0, 250.0, 500.0])
    return parser.parse_args()


if __name__ == "__main__":
    main()
