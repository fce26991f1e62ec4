"""How far a vehicle flies until single-beam soundings tell where it is: by batches and by the point-mass filter.

From places along the flight, with an initial error of 1-sigma 500 m or 2 km (each axis; height 10 m) and MEMS odometry: the batch
matches the last 3, then 6, 9, ... km, the filter takes the soundings one by one; each until it answers, or for 15 km.
`python -m benchmarks.terrain_converge [--seeds N]`; benchmarks.terrain ends with the same table.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.terrain_flights.terrain_flight import DRIFTS, SPEED_MPS, STEP_S, Flight, beam, make_flight
from benchmarks.terrain_flights.terrain_run import Run
from benchmarks.terrain_flights.terrain_world import World, elevation_model, make_world
from visloc_companion.localise.terrain.base import Kind, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.noise import HeightNoise
from visloc_companion.localise.terrain.point_mass import PointMassFilter, Region
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.types import FloatArray

CELL_M = 20.0
STARTS = 4
LONGEST_M, BATCH_M, SPACING_M = 15_000.0, 3000.0, 30.0
SIGMA_H_M = 10.0
RANGE_SIGMA_M = 0.5
DRIFT_MPS = 1.0
CONCENTRATED, GOOD_SIGMA_M = 0.99, 15.0
RIGHT_M = 30.0


@dataclass(frozen=True, slots=True)
class Converged:
    """After how far there was an answer (None: none), its error, its 1-sigma, and what it cost."""

    after_m: float | None
    error_m: float
    sigma_m: float
    cpu_s: float


def report(seeds: Iterable[int], dem: Path | None) -> None:
    """Both methods from both errors, as a table."""
    print("| method | initial 1-sigma m | n | answered | answered, off by > 30 m | after km 50/95 | error m 50/95 | s CPU |")
    print("|---|---|---|---|---|---|---|---|")
    found: dict[tuple[str, float], list[Converged]] = {}
    for seed in seeds:
        world = make_world(seed, dem)
        elevation = elevation_model(world, CELL_M, seed)
        flight = make_flight(world, DRIFTS["mems"], seed)
        for sigma in (500.0, 2000.0):
            for start in range(STARTS):
                first = round((start + 0.5) / STARTS * (len(flight.p_ne_m) - LONGEST_M / SPEED_MPS / STEP_S))
                rng = np.random.default_rng([seed, start, round(sigma)])
                off = rng.normal(0, sigma, 2)
                for name, method in (("batch", batch), ("point mass", point_mass)):
                    found.setdefault((name, sigma), []).append(method(world, elevation, flight, first, off, sigma))
    for (name, sigma), every in found.items():
        print(_row(name, sigma, every), flush=True)


def batch(world: World, elevation: ElevationMap, flight: Flight, first: int, off: FloatArray, sigma: float) -> Converged:
    """Longer and longer profiles until one is accepted."""
    run = Run(world, elevation, flight, first, Kind.PROFILE, RANGE_SIGMA_M)
    taken, spent = 0.0, time.process_time()
    for length in np.arange(BATCH_M, LONGEST_M + 1, BATCH_M):
        end = first + round(length / SPEED_MPS / STEP_S)
        steps = np.arange(first, end)
        stretch = run.stretch([beam(world, flight, steps, np.random.default_rng(first), RANGE_SIGMA_M)], end)
        if stretch is None:
            continue
        answer = locate(stretch, _prior(run, flight, end, off, sigma), elevation, TerrainSettings())
        if isinstance(answer, TerrainFix):
            taken = float(length)
            error = float(np.hypot(*(np.array(answer.p_ne_m) - flight.p_ne_m[end])))
            return Converged(taken, error, math.sqrt(answer.cov_ne_m2[0][0]), time.process_time() - spent)
    return Converged(None, math.nan, math.nan, time.process_time() - spent)


def point_mass(world: World, elevation: ElevationMap, flight: Flight, first: int, off: FloatArray, sigma: float) -> Converged:
    """Soundings one by one until the probability has gathered at one place."""
    start = time.process_time()
    cell = 2 * sigma / 33
    noise = HeightNoise(math.hypot(elevation.sigma_m, RANGE_SIGMA_M))
    grid = PointMassFilter(elevation, Region((0.0, 0.0, 0.0), (3 * sigma, 3 * sigma, 24.0), cell, 2.0), noise)
    drift = np.cumsum(flight.velocity_error_mps[first:], axis=0) * STEP_S
    every = round(SPACING_M / SPEED_MPS / STEP_S)
    rng = np.random.default_rng(first)
    height_off = rng.normal(0, SIGMA_H_M)
    settings = TerrainSettings()
    for k, step in enumerate(range(first, first + round(LONGEST_M / SPEED_MPS / STEP_S), every)):
        points, _ = beam(world, flight, np.arange(step, step + every), rng, RANGE_SIGMA_M)
        if len(points):
            low = points[np.argmin(points[:, 2])]
            at = flight.p_ne_m[step] + drift[step - first] + off + low[:2]
            grid.observe(
                (float(at[0]), float(at[1])),
                float(flight.h_amsl_m[step] + height_off + low[2]),
                SPACING_M / settings.correlation_m,
            )
        grid.carry(DRIFT_MPS**2 * every * STEP_S)
        if k % 10 != 9:
            continue
        while grid.lay_anew():
            pass
        got = grid.estimate()
        worst = math.sqrt(float(np.linalg.eigvalsh(got.covariance_m2[:2, :2])[-1]))
        if got.concentrated > CONCENTRATED and worst < GOOD_SIGMA_M:
            error = float(np.hypot(*(got.mean_m[:2] - off - drift[step - first])))
            return Converged((step - first) * STEP_S * SPEED_MPS, error, worst, time.process_time() - start)
    return Converged(None, math.nan, math.nan, time.process_time() - start)


def _prior(run: Run, flight: Flight, end: int, off: FloatArray, sigma: float) -> TerrainPrior:
    at = flight.p_ne_m[end] + off
    cov = ((sigma**2, 0.0), (0.0, sigma**2))
    h = float(flight.h_indicated_m[end])
    return TerrainPrior(
        (float(at[0]), float(at[1])), cov, h, SIGMA_H_M, flight.drift.heading_rad, flight.drift.tilt_rad, DRIFT_MPS
    )


def _row(name: str, sigma: float, every: list[Converged]) -> str:
    answered = [c for c in every if c.after_m is not None]
    far = sum(c.error_m > RIGHT_M for c in answered)
    after, error = (np.array([getattr(c, k) for c in answered] or [np.nan]) for k in ("after_m", "error_m"))
    km = " / ".join(f"{v / 1000:.1f}" for v in np.percentile(after, [50, 95]))
    off = " / ".join(f"{v:.0f}" for v in np.percentile(error, [50, 95]))
    cost = np.median([c.cpu_s for c in every])
    return f"| {name} | {sigma:.0f} | {len(every)} | {len(answered)} | {far} | {km} | {off} | {cost:.1f} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    report(range(1, 1 + parser.parse_args().seeds), None)
