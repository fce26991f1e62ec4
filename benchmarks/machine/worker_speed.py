"""Wall time and peak memory of a localiser in a process of its own, over a pack with stored features, as in flight.

Part of `benchmarks.speed`. Tracking: prior ±30 m (17 m), 2 degrees of heading, 2 % of height (1-sigma). Whole map: a region of
900 x 700 pixels of which the footprint takes 173, ±10 degrees, ±8 % of height. Wall time means something on a machine that has
nothing else to do.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from benchmarks.landscape import MODEL
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import NetworkChoice
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import Fix, GeoPoint, Image, LocaliseRequest

Posed = tuple[GeoPoint, Image, LocaliseRequest]
TRACKING_M = (17.0, 17.0)
ABOVE_M = 120.0
"""Mean height of the cases above the ground."""
PIXEL_M = 0.7
"""Ground under a pixel of which the footprint from 120 m takes 173 (its side by area is 120 m)."""
WHOLE_M = (700 * PIXEL_M / 6, 900 * PIXEL_M / 6)
"""1-sigma north and east: 3 sigma to either side are the map."""


@dataclass(frozen=True, slots=True)
class Run:
    """A measurement: times in milliseconds, memory of the process in MB, and the share of fixes within 5 m."""

    wall_ms: float
    cpu_ms: float
    peak_mb: float
    right: float


def report(pack: Path, todo: list[Posed], methods: list[str], threads: int) -> None:
    """Print the table."""
    print(f"| in a worker, {threads} threads | median ms (wall) | a second | median ms (CPU) | peak memory MB | within 5 m |")
    print("|" + "---|" * 6)
    for name, jobs in (("tracking", tracking(todo)), ("whole map of 900 x 700 px", whole_map(todo))):
        for method in methods:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
                run = pool.submit(measured, pack, jobs, method, threads).result()
            rates = (
                f"{run.wall_ms:.0f} | {1e3 / run.wall_ms:.1f} | {run.cpu_ms:.0f} | {run.peak_mb:.0f} | {100 * run.right:.0f} %"
            )
            print(f"| {method}, {name} | {rates} |")


def tracking(todo: list[Posed]) -> list[Posed]:
    """The cases with the prior of a flight that is being followed."""
    return [_with_prior(case, k, TRACKING_M, math.radians(2.0), 0.02) for k, case in enumerate(todo)]


def whole_map(todo: list[Posed]) -> list[Posed]:
    """The cases with a prior that leaves the whole region open."""
    return [_with_prior(case, k, WHOLE_M, math.radians(10.0 / 3), 0.08 / 3) for k, case in enumerate(todo)]


def measured(pack: Path, todo: list[Posed], method: str, threads: int) -> Run:
    """Localise each case once, after one to warm up. For a process of its own: memory is that of the whole process."""
    cv2.setNumThreads(1)
    features = open_features_for(method, NetworkChoice(threads=threads))
    localiser = make_localiser(method, MODEL, features=features, threads=threads)
    reference = PackMap.open(pack, verify_hashes=False)
    localiser.localise(todo[0][2], todo[0][1], reference)
    wall, cpu, right = [], [], 0
    for place, pixels, request in todo:
        start = time.perf_counter(), time.process_time()
        answer = localiser.localise(request, pixels, reference)
        wall.append(1e3 * (time.perf_counter() - start[0]))
        cpu.append(1e3 * (time.process_time() - start[1]))
        right += isinstance(answer, Fix) and distance_m(answer.place, place) < 5
    return Run(float(np.median(wall)), float(np.median(cpu)), _peak_mb(), right / len(todo))


def _peak_mb() -> float:
    """Largest resident memory of this program (Linux); getrusage's is also its parent's, whose process it was before."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024


def _with_prior(case: Posed, seed: int, sigma_m: tuple[float, float], sigma_yaw_rad: float, sigma_h: float) -> Posed:
    """The case with a prior about the true place, uniform of these sigmas, and the case's own attitude."""
    place, pixels, request = case
    rng = np.random.default_rng(seed)
    offset = math.sqrt(3) * rng.uniform(-1, 1, 3) * np.array([*sigma_m, sigma_h * ABOVE_M])
    prior = replace(
        request.prior,
        place=geo_from_ned((float(offset[0]), float(offset[1]), float(offset[2])), place),
        cov_ne_m2=((sigma_m[0] ** 2, 0.0), (0.0, sigma_m[1] ** 2)),
        sigma_h_m=sigma_h * ABOVE_M,
        sigma_yaw_rad=sigma_yaw_rad,
    )
    return place, pixels, replace(request, prior=prior)
