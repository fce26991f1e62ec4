"""Time of a localisation against a fixed piece of work measured in the same run: `python -m benchmarks.speed [--frames N]`.

Absolute times depend on the machine and on who else uses it; the ratio to OpenCV's SIFT on the same frame (detection and
description, one thread) does so much less. All run in turn on every frame, the medians are compared. Each method runs over a pack
that holds its features, as in flight, and over the bare rasters, where the map's are computed for every frame. Wall times and
memory of a worker (`benchmarks.machine.worker_speed`) and the cost of the search alone (`benchmarks.search_cost`) follow.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from benchmarks import search_cost
from benchmarks.landscape import cases, localiser_of
from benchmarks.machine import worker_speed
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.raster import RasterMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.scene import Scene
from visloc_companion.types import Image

SIZE_M = 1000.0
SIFT = "SIFT on the frame"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--methods", nargs="+", default=["deep", "gradient", "keypoint"])
    parser.add_argument("--threads", type=int, default=2, help="of the worker whose wall time is measured")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    world = procedural_world(1, size_m=SIZE_M)
    todo = cases(Scene.load(world.flight_ortho, world.flight_dsm), 3, options.frames)
    maps = {
        "map's features in the pack": PackMap.open(world.pack, verify_hashes=False),
        "map's features computed": RasterMap.open(world.pack / "ortho.tif", world.pack / "dsm.tif"),
    }
    localisers = {method: localiser_of(method) for method in options.methods}
    sift = cv2.SIFT_create()
    took: dict[str, list[float]] = {}
    for _, pixels, request in todo:
        for where, reference in maps.items():
            for method, localiser in localisers.items():
                taken = cpu_ms(lambda at=reference, who=localiser: who.localise(request, pixels, at))  # noqa: B023 called at once
                took.setdefault(f"{method}, {where}", []).append(taken)
        took.setdefault(SIFT, []).append(cpu_ms(lambda: sift.detectAndCompute(grey(pixels), None)))  # noqa: B023
    print("| what | median ms (CPU) | ratio to SIFT |")
    print("|---|---|---|")
    for name, values in took.items():
        print(f"| {name} | {np.median(values):.0f} | {np.median(values) / np.median(took[SIFT]):.2f} |")
    print()
    worker_speed.report(world.pack, todo, options.methods, options.threads)
    print()
    search_cost.report(repeats=5)


def cpu_ms(work: Callable[[], object]) -> float:
    """Milliseconds of CPU, of all threads, that some work takes."""
    start = time.process_time()
    work()
    return 1e3 * (time.process_time() - start)


def grey(pixels: Image) -> Image:
    """What SIFT wants."""
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


if __name__ == "__main__":
    main()
