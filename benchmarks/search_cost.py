"""What the exhaustive search costs: `python -m benchmarks.search_cost [--repeats N]`, also at the end of `benchmarks.speed`.

Features are noise of the size that a working level has (a footprint of 90 px by area, 4:3), as time does not depend on their
values. CPU time is for one thread; wall time for one and two means something on an otherwise idle machine only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.candidates.posterior import posterior
from visloc_companion.localise.search import ScoreVolume, Template, search
from visloc_companion.localise.spectra import Box

FULL, FEW = (9, 5), (3, 3)


@dataclass(frozen=True, slots=True)
class Load:
    """A search: columns x rows of positions, headings x scales, channels, side (px) of the footprint."""

    positions: tuple[int, int]
    grid: tuple[int, int]
    channels: int
    side_px: float = 90.0

    @property
    def unit(self) -> int:
        """Positions x hypotheses x channels."""
        return int(np.prod(self.positions) * np.prod(self.grid)) * self.channels


def prepared(load: Load, seed: int = 0) -> Callable[[int], float]:
    """The search as a function of the number of threads; it returns the highest score."""
    rng = np.random.default_rng(seed)
    base = rng.normal(size=(int(2 * load.side_px), int(2 * load.side_px), load.channels)).astype(np.float32)
    headings, scales = (np.linspace(-reach, reach, n) for reach, n in zip((0.3, 0.13), load.grid, strict=True))
    templates = [_template(base, load.side_px, h, float(np.exp(s))) for h in headings for s in scales]
    low = np.array([t.offset_px for t in templates]).min(0)
    high = np.array([np.add(t.offset_px, t.mask.shape[::-1]) for t in templates]).max(0) - 1
    extent: Box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    width, height = load.positions
    features = rng.normal(size=(height + extent[3] - extent[1], width + extent[2] - extent[0], load.channels)).astype(np.float32)
    weight = np.ones(features.shape[:2], np.float32)
    box = (-extent[0], -extent[1], width - 1 - extent[0], height - 1 - extent[1])

    def run(threads: int) -> float:
        volume = search(features, weight, templates.__getitem__, len(templates), box, extent, threads=threads)
        return float(volume.score.max())

    return run


def _template(base: np.ndarray, side_px: float, heading_rad: float, scale: float) -> Template:
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    half = 0.5 * side_px * scale * np.array([3**-0.5 * 2, 3**0.5 / 2])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[c, s], [-s, c]])
    low, high = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
    width, height = high - low + 1
    mask = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners - low).astype(np.int32), 1)
    return Template(base[:height, :width], mask.astype(np.float32), (int(low[0]), int(low[1])))


def measured(load: Load, repeats: int) -> tuple[float, float, float]:
    """Least CPU ms with one thread, and wall ms with one and two."""
    run = prepared(load)
    run(2)
    cpu, one, two = [], [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        run(1)
        one.append(1e3 * (time.perf_counter() - start))
        cpu.append(1e3 * (time.process_time() - start_cpu))
        start = time.perf_counter()
        run(2)
        two.append(1e3 * (time.perf_counter() - start))
    return min(cpu), min(one), min(two)


def report(repeats: int) -> None:
    """Print the loads that have budgets, then the law."""
    print("| search | positions | hypotheses | channels | CPU ms | wall ms, 1 thread | 2 threads |")
    print("|---|---|---|---|---|---|---|")
    for name, positions, grid in (("whole map of 900 x 700 px", (470, 365), FULL), ("tracking, prior ±30 m", (33, 33), FEW)):
        for channels in (10, 2):
            load = Load(positions, grid, channels)
            cpu, one, two = measured(load, repeats)
            width, height = positions
            print(f"| {name} | {width} x {height} | {grid[0]} x {grid[1]} | {channels} | {cpu:.1f} | {one:.1f} | {two:.1f} |")
    print("\n| positions a side | footprint px | CPU ms a hypothesis | ns a position, hypothesis and channel |")
    print("|---|---|---|---|")
    areas, costs = [], []
    for side, footprint in ((50, 90), (100, 90), (200, 90), (400, 90), (800, 90), (400, 45), (400, 180)):
        load = Load((side, side), FEW, 10, footprint)
        cpu, _, _ = measured(load, repeats)
        print(f"| {side} | {footprint} | {cpu / np.prod(FEW):.2f} | {1e6 * cpu / load.unit:.2f} |")
        if footprint == 90:
            areas.append(side * side)
            costs.append(cpu / np.prod(FEW))
    slope, constant = np.polyfit(areas, costs, 1, w=1 / np.array(costs))
    print(f"\nLaw at 90 px: {1e6 * slope:.0f} ns a position + {constant:.2f} ms, for each hypothesis of ten channels.")
    print(f"The posterior of 470 x 365 positions takes {posterior_ms(repeats):.1f} ms CPU.")


def posterior_ms(repeats: int) -> float:
    """CPU ms of the posterior of a whole map's score volume."""
    rng = np.random.default_rng(0)
    score = cv2.GaussianBlur(rng.normal(size=(365, 470)).astype(np.float32), (0, 0), 2)
    volume = ScoreVolume(score, np.zeros(score.shape, np.int32), (0, 0))
    times = []
    for _ in range(repeats):
        start = time.process_time()
        posterior(volume, np.ones(score.shape, np.bool_), 0.02)
        times.append(1e3 * (time.process_time() - start))
    return min(times)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    report(options.repeats)


if __name__ == "__main__":
    main()
