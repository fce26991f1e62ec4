"""How far the prior may be off: `python -m benchmarks.cloud_reach [--n N] [--seed S] [--errors 100 250 500]`.

The reference is the surface of the procedural landscape on its map's date (2 km, a point a square metre); the source 67 m of it,
in March five years later (leafless, fields divided anew, stands felled, buildings new), 4 points a square metre, 0.2 m of noise.
Heading errors up to 5 deg, tilt 0.5 deg, scale 2 %, height 5 m, all uniform; the place uniform in a square of the error's half
side. Prints, for each error, the shares within 5 m and accepted, the median error, CPU time and the process's peak of memory.
"""

from __future__ import annotations

import argparse
import resource

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.cloud_answers import answer_of
from benchmarks.cloud_cases import CloudCase
from visloc_companion.localise.registration.base import RegistrationPrior
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, make_registration
from visloc_companion.localise.registration.similarity import turned, with_linear
from visloc_companion.sim.landscape import build_landscape

Array = NDArray[np.float64]
SIZE_M, GSD_M, SOURCE_M, NOISE_M = 2000.0, 1.0, 67.0, 0.2
HEADER = "| prior error m | n | < 5 m % | accepted % | accepted, wrong | median m | CPU s | peak MB |"
YAW_DEG, TILT_DEG, SCALE, UP_M = 5.0, 0.5, 0.02, 5.0


def main() -> None:
    """Make the landscape, register, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--errors", type=float, nargs="+", default=[60.0, 100.0, 250.0, 500.0])
    args = parser.parse_args()
    old, new = (build_landscape(args.seed, date, SIZE_M, GSD_M).dsm_amsl_m for date in ("map", "flight"))
    method = make_registration("height-search", 1.0)
    reference = _points(old, np.random.default_rng(args.seed), np.zeros(2), SIZE_M - 4, 1.0, 0.05)
    print(f"{HEADER}\n|{'---|' * 8}", flush=True)
    for error_m in args.errors:
        found = [answer_of(method, _case(new, reference, error_m, args.seed, k)) for k in range(args.n)]
        taken = [a for a in found if a.probability_wrong <= DEFAULT_MAX_PROBABILITY_WRONG]
        right = 100 * np.mean([not a.wrong for a in found])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"| {error_m:.0f} | {len(found)} | {right:.1f} | {100 * len(taken) / len(found):.1f} | {sum(a.wrong for a in taken)} "
            f"| {np.median([a.horizontal_m for a in found]):.2f} | {np.median([a.cpu_s for a in found]):.2f} | {peak:.0f} |",
            flush=True,
        )


def _case(surface: NDArray[np.float32], reference: Array, error_m: float, seed: int, k: int) -> CloudCase:
    rng = np.random.default_rng([seed, int(error_m), k])
    place = rng.uniform(-1, 1, 2) * (SIZE_M / 2 - SOURCE_M)
    source = _points(surface, rng, place, SOURCE_M, 4.0, NOISE_M)
    yaw, tilt_x, tilt_y = np.radians(rng.uniform(-1, 1, 3) * [YAW_DEG, TILT_DEG, TILT_DEG])
    linear = (1 + rng.uniform(-SCALE, SCALE)) * turned(tilt_x, tilt_y, yaw)
    middle = np.append(place, source[:, 2].mean())
    lies = middle - np.append(rng.uniform(-error_m, error_m, 2), rng.uniform(-UP_M, UP_M))
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


if __name__ == "__main__":
    main()
