"""Time of a localisation against a fixed piece of work measured in the same run: `python -m benchmarks.speed [--frames N]`.

Absolute times depend on the machine and on who else uses it; the ratio to OpenCV's SIFT on the same frame (detection and
description, one thread) does so much less. Both run alternately, the medians are compared. The cost of the search
alone follows (`benchmarks.search_cost`).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks import search_cost
from benchmarks.landscape import MODEL, cases
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.raster import RasterMap
from visloc_companion.sim.landscape import build_landscape

SIZE_M = 1000.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    todo = cases(build_landscape(1, "flight", size_m=SIZE_M), 3, options.frames)
    with tempfile.TemporaryDirectory() as folder:
        ortho, dsm = build_landscape(1, "map", size_m=SIZE_M).save(Path(folder))
        reference = RasterMap.open(ortho, dsm)
        localiser = make_localiser("gradient", MODEL)
        sift = cv2.SIFT_create()
        whole, claimed, base = [], [], []
        for _, pixels, request in todo:
            start = time.process_time()
            answer = localiser.localise(request, pixels, reference)
            whole.append(1e3 * (time.process_time() - start))
            claimed.append(answer.elapsed_ms)
            start = time.process_time()
            sift.detectAndCompute(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), None)
            base.append(1e3 * (time.process_time() - start))
    print("| what | median ms (CPU) | ratio to SIFT |")
    print("|---|---|---|")
    for name, values in (("gradient, whole", whole), ("gradient, map's features at hand", claimed), ("SIFT on the frame", base)):
        print(f"| {name} | {np.median(values):.0f} | {np.median(values) / np.median(base):.2f} |")
    print()
    search_cost.report(repeats=5)


if __name__ == "__main__":
    main()
