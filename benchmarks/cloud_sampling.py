"""Clouds whose points were rounded, copied or resampled: `python -m benchmarks.cloud_sampling CLOUDS WORK [--n N] [--seed S]`.

The cases are those of `benchmarks.clouds` at level normal, on land; their points are changed about a place of UTM before they are
registered. Prints for each change how many are accepted, and of these how many are wrong, the median horizontal error, the share
in the claimed 95 % ellipse, the median protection level and how many errors are beyond theirs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.cloud_sets.cloud_answers import CloudAnswer, answer_of
from benchmarks.cloud_sets.cloud_cases import BLANK, Array, CloudCase, make, read
from visloc_companion.evaluate.protection import horizontal_bound_m
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, make_registration

SEED = 503
UTM_M = np.array([500_123.37, 5_512_345.61, 212.4])
SOUTH_M = UTM_M + np.array([0.0, 4_000_000.0, 0.0])
Change = Callable[[Array], Array]


def rounded(points_m: Array) -> Array:
    """To whole metres, heights too."""
    return np.asarray(np.rint(points_m + UTM_M) - UTM_M, dtype=np.float64)


def cut_off(points_m: Array) -> Array:
    """To the whole metres below."""
    return np.asarray(np.floor(points_m + UTM_M) - UTM_M, dtype=np.float64)


def single(points_m: Array, place_m: Array = UTM_M) -> Array:
    """As float32 keeps them there."""
    return np.asarray((points_m + place_m).astype(np.float32).astype(np.float64) - place_m, dtype=np.float64)


def southern(points_m: Array) -> Array:
    """As float32 keeps them in the UTM of the south."""
    return single(points_m, SOUTH_M)


def thrice(points_m: Array) -> Array:
    """Each point three times."""
    return np.repeat(points_m, 3, axis=0)


def raster(points_m: Array) -> Array:
    """The highest points of cells of a metre, in the cells' middle."""
    index = np.floor(points_m[:, :2] + UTM_M[:2]).astype(np.int64)
    low = index.min(0)
    wide = int(np.ptp(index[:, 1])) + 1
    flat = (index - low) @ np.array([wide, 1])
    top = np.full(int(flat.max()) + 1, -np.inf)
    np.maximum.at(top, flat, points_m[:, 2])
    known = np.flatnonzero(np.isfinite(top))
    middle = np.column_stack([known // wide, known % wide]) + low + 0.5 - UTM_M[:2]
    return np.column_stack([middle, top[known]])


CHANGES: dict[str, tuple[Change | None, Change | None]] = {
    "as they are": (None, None),
    "reference three times": (None, thrice),
    "source rounded": (rounded, None),
    "both rounded": (rounded, rounded),
    "source cut off": (cut_off, None),
    "reference in float32": (None, single),
    "reference in float32, south": (None, southern),
    "source a raster": (raster, None),
}
"""Of the source, of the reference."""


def changed(case: CloudCase, how: tuple[Change | None, Change | None]) -> CloudCase:
    """The case with other points, at the same place."""
    source, reference = (p if f is None else f(p) for f, p in zip(how, (case.source_m, case.reference_m), strict=True))
    return replace(case, source_m=source, reference_m=reference)


def row(found: list[CloudAnswer]) -> str:
    """What was accepted and how it holds."""
    taken = [a for a in found if a.probability_wrong <= DEFAULT_MAX_PROBABILITY_WRONG]
    right = [a for a in taken if not a.wrong]
    errors = np.array([a.horizontal_m for a in right])
    levels = np.array([horizontal_bound_m(a.covariance_m2[:2, :2]) for a in right])
    cells = [f"{len(found)}", f"{len(taken)}", f"{len(taken) - len(right)}", f"{np.median(errors):.2f}"]
    cells += [f"{100 * np.mean([a.inside for a in right]):.0f} %", f"{np.median(levels):.2f}", f"{int((errors > levels).sum())}"]
    return " | ".join(cells)


def main() -> None:
    """Make, change, answer, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", type=Path, help="folder of .laz files, as the shared tool takes it")
    parser.add_argument("work", type=Path, help="where the cases are kept")
    parser.add_argument("--n", type=int, default=3, help="cases a cloud and scenario")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--changes", nargs="+", choices=list(CHANGES), default=list(CHANGES))
    args = parser.parse_args()
    folder, method = make(args.clouds, args.work, "normal", args.n, args.seed), make_registration("height-search", 1.0)
    print(
        "| points | n | accepted | wrong | median m | in 95 % ellipse | level m | beyond it |\n|---|---|---|---|---|---|---|---|"
    )
    for name in args.changes:
        cases = (case for case in read(folder, "normal") if case.cover not in BLANK)
        print(f"| {name} | {row([answer_of(method, changed(case, CHANGES[name])) for case in cases])} |", flush=True)


if __name__ == "__main__":
    main()
