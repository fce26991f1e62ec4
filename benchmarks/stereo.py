"""How right motion stereo's clouds are, against simulated truth.

    python -m benchmarks.stereo [--seeds 1 2] [--places 6] [--size 700] [--gsd 0.25] [--report DIR] [--json FILE]

Three frames of 640 x 480 px (73.9° x 58.9°) 90 m above the procedural landscape, either season, neighbours overlapping by 50 to
80 %, with lens, blur and noise; priors off by 0.5° of each attitude angle and 0.3 m of each axis of a baseline (1-sigma, each
frame on its own). A box world first shows what renderer and stereo make of known heights. Seeds 1 to 3 served for tuning.

Height error: of a point against the surface model at its own place. `raw` as it is, with the scale of the baselines or of a
rangefinder (0.3 m); `shape` after the similarity that all points share, which registration finds. `bowl`: what a
paraboloid through the errors rises from the middle to 50 m. Complete: share of the 1 m cells within two frames or more that have
a point (what is hidden counts as missing); `and right`: to 1 m. sigma: errors' robust spread in claimed sigmas; offset:
that of the clouds' shift in height, by scale and by the middle of three priors. Rough: median
height by which the truth itself stands off its mean over 1.25 m, which no window of stereo resolves.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.stereo_report import picture, table
from benchmarks.worlds.stereo_world import (
    COVERS,
    HEIGHT_M,
    MODEL,
    SIGMA_BASELINE_M,
    Flight,
    World,
    box_world,
    fly,
    landscape,
    ranged,
)
from visloc_companion.localise.structure.base import LocalCloud, StereoSettings
from visloc_companion.localise.structure.cloud import local_cloud
from visloc_companion.types import FloatArray

SIGMA_RANGE_M = 0.3
RIGHT_M = 1.0
Row = dict[str, Any]


def judged(flight: Flight, rng: np.random.Generator, settings: StereoSettings) -> tuple[Row, LocalCloud | None, FloatArray]:
    """Figures of one flight, its cloud and the cloud's errors after the similarity."""
    started = time.process_time()
    cloud = local_cloud(flight.frames, MODEL, settings)
    seconds = time.process_time() - started
    row: Row = {"date": flight.world.date, "overlap": flight.overlap, "seconds": seconds}
    if not isinstance(cloud, LocalCloud):
        return {**row, "refused": cloud.reason.value, "detail": cloud.detail}, None, np.zeros(0)
    raw = _raw(cloud, flight)
    with_range = local_cloud(ranged(flight, rng, SIGMA_RANGE_M), MODEL, settings)
    points, shape, bowl = _aligned(flight, cloud.points_m)
    cell_cover, rough, has, right = _cells(flight, points, shape)
    row |= {
        "raw": _median(raw),
        "offset": abs(float(np.nanmedian(raw)))
        / math.hypot(HEIGHT_M * cloud.sigma_scale, SIGMA_BASELINE_M / math.sqrt(6))
        / 0.6745,
        "raw_range": _median(_raw(with_range, flight)) if isinstance(with_range, LocalCloud) else None,
        "shape": _median(shape),
        "p90": float(np.nanpercentile(np.abs(shape), 90)),
        "within": float(np.nanmean(np.abs(shape) < RIGHT_M)),
        "bowl": bowl,
        "complete": float(has.mean()),
        "right": float(right.mean()),
        "sigma": _median(shape / cloud.sigma_m) / 0.6745,
        "points": len(raw),
        "scale_sigma": cloud.sigma_scale,
        "evidence": dict(cloud.evidence),
        "covers": {},
    }
    cover = flight.truth_at(points[:, :2])[1]
    for number, name in enumerate(COVERS):
        mine, ground = cover == number, cell_cover == number
        if mine.sum() >= 300 and ground.sum() >= 100:
            row["covers"][name] = {
                **{"cells": int(ground.sum()), "shape": _median(shape[mine]), "bias": float(np.nanmedian(shape[mine]))},
                **{"p90": float(np.nanpercentile(np.abs(shape[mine]), 90)), "within": float((np.abs(shape[mine]) < 1).mean())},
                **{"complete": float(has[ground].mean()), "right": float(right[ground].mean())},
                "rough": float(np.median(rough[ground])),
            }
    return row, cloud, shape


def _raw(cloud: LocalCloud, flight: Flight) -> FloatArray:
    return np.asarray(cloud.points_m[:, 2] - flight.truth_at(cloud.points_m[:, :2])[0], dtype=np.float64)


def _median(errors: FloatArray) -> float:
    return float(np.nanmedian(np.abs(errors)))


def _aligned(flight: Flight, points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """The points after the similarity that fits them best to the surface (robust point-to-surface steps), errors, the bowl."""
    moved, left = points, np.zeros(len(points))
    middle = points.mean(0)
    near = np.ones(len(points), np.bool_)
    for step in range(7):
        left = moved[:, 2] - flight.truth_at(moved[:, :2])[0]
        left = np.where(np.isfinite(left), left, 99.0)
        near = np.abs(left - np.median(left)) < max(0.3, 4.5 * float(np.median(np.abs(left - np.median(left)))))
        if step == 6:
            break
        J = _columns(flight, moved, middle)
        turn_e, turn_n, yaw, scale, *shift = np.linalg.lstsq(J[near], -left[near], rcond=None)[0]
        r = moved - middle
        moved = moved + np.array(shift) + scale * r + np.cross(np.array([turn_e, turn_n, yaw]), r)
    bowl = np.column_stack([_columns(flight, moved, middle), ((moved - middle)[:, :2] ** 2).sum(1)])
    return moved, left, float(np.linalg.lstsq(bowl[near], left[near], rcond=None)[0][-1] * 50**2)


def _columns(flight: Flight, points: FloatArray, middle: FloatArray) -> FloatArray:
    """(N, 7) by how much an error changes with a turn about east, north, up, with scale, and with a shift."""
    e, n = (flight.slope_at(points[:, :2], axis) for axis in (0, 1))
    normal = np.column_stack([-e, -n, np.ones(len(points))])
    r = points - middle
    return np.column_stack([np.cross(r, normal), (r * normal).sum(1), normal])


def _cells(
    flight: Flight, points: FloatArray, shape: FloatArray
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """1 m cells within two frames: cover, roughness, which have a point, and one that is right."""
    reach = int(2.2 * HEIGHT_M)
    e, n = np.meshgrid(np.arange(-reach, reach) + 0.5, np.arange(-reach, reach) + 0.5)
    cells = np.column_stack([e.ravel(), n.ravel()])
    cells = cells[flight.seen_twice(cells)]
    has, right = (_occupied(cells, points[mine, :2], reach) for mine in (slice(None), np.abs(shape) < RIGHT_M))
    return flight.truth_at(cells)[1], flight.roughness_at(cells), has, right


def _occupied(cells: FloatArray, points: FloatArray, reach: int) -> NDArray[np.bool_]:
    filled = np.zeros((2 * reach, 2 * reach), np.bool_)
    at = np.floor(points).astype(int) + reach
    at = at[((at >= 0) & (at < 2 * reach)).all(1)]
    filled[at[:, 0], at[:, 1]] = True
    i, j = (np.floor(cells).astype(int) + reach).T
    return np.asarray(filled[i, j], dtype=np.bool_)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--places", type=int, default=6, help="flights for each seed and season")
    parser.add_argument("--size", type=float, default=700.0, help="side of the landscape, metres")
    parser.add_argument("--gsd", type=float, default=0.25, help="resolution of the landscape, metres")
    parser.add_argument("--report", type=Path, help="folder for table and pictures")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[Row] = []

    def go(world: World, rng: np.random.Generator, overlap: float, name: str, at: tuple[float, float] | None = None) -> None:
        flight = fly(world, rng, overlap, at=at)
        row, cloud, shape = judged(flight, rng, StereoSettings())
        rows.append({"name": name, **row})
        if options.report and cloud is not None:
            picture(options.report / f"{name}.png", flight, cloud, shape)

    for gsd in (0.5, options.gsd):
        go(box_world(gsd), np.random.default_rng(1), 0.7, f"box-{gsd:g}", (0.5, 0.5))
        print(json.dumps({k: rows[-1].get(k) for k in ("name", "raw", "shape", "p90", "right", "refused", "covers")}), flush=True)
    for seed in options.seeds:
        for date in ("map", "flight"):
            world = landscape(seed, date, options.size, options.gsd)
            rng = np.random.default_rng([seed, date == "map"])
            for place in range(options.places):
                go(world, rng, 0.5 + 0.3 * (place + float(rng.random())) / options.places, f"{seed}-{date}-{place}")
    text = "\n".join(table(rows))
    print(text)
    if options.report:
        options.report.mkdir(parents=True, exist_ok=True)
        (options.report / "table.md").write_text(text + "\n", encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps({"schema": 1, "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
