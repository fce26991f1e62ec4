"""Fit which of several candidates is the place: `python -m benchmarks.rank FOLDER [--method NAME] [--n N] [--model DIR]`.

Conditional logit over the refined candidates of training cases (benchmarks/image_cases/training_sets.py; no test rows). Prints
the weights of localise/candidates/ranking.py and how often the best candidate, and any candidate, is right.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.image_cases.training_sets import SETS
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_cases, read_frame, read_truth
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.localise.answer import Stopwatch
from visloc_companion.localise.candidates.matching import Task, find_candidates, refined_candidates, standing
from visloc_companion.localise.candidates.ranking import DEEP_RANK, GRADIENT_RANK
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.frame import full_level
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import GeoPoint

USED = ("t2", "wide", "low128", "low96", "low64", "low48", "oblique", "pairs128", "pairs64", "land128", "land64")
RIGHT_PX = 6.0
Array = NDArray[np.float64]
Candidates = tuple[Array, Array]
"""Regressors (N, K) and whether right (N,) of the candidates of a case."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", choices=("gradient", "deep"), default="deep")
    parser.add_argument("--n", type=int, default=60, help="cases of each set")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--model", type=Path)
    args = parser.parse_args()
    model = None if args.method == "gradient" else (args.model or Path())
    found: list[Candidates] = []
    for name in USED:
        folder = SETS[name](args.folder / "cases")
        cases, truth = read_cases(folder)[: args.n], read_truth(folder)
        todo = [(case, truth[case.case_id], model) for case in cases if not isinstance(case, BadCase)]
        with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            here = [c for c in pool.map(candidates_of, todo, chunksize=4) if c is not None]
        weights = np.array(GRADIENT_RANK if args.method == "gradient" else DEEP_RANK)
        best = [bool(right[int(np.argmax(x @ weights))]) for x, right in here]
        among = [bool(right.any()) for _, right in here]
        print(
            f"{name}: best candidate right in {np.mean(best):.1%}, one of them in {np.mean(among):.1%} of {len(here)}", flush=True
        )
        found += here
    weights = fit([c for c in found if 0 < c[1].sum() < len(c[1])])
    print("weights", tuple(float(f"{w:.3g}") for w in weights))
    print(f"best candidate right in {np.mean([right[int(np.argmax(x @ weights))] for x, right in found]):.1%} of all")


def candidates_of(todo: tuple[Case, Truth, Path | None]) -> Candidates | None:
    """The refined candidates of a case; None where there are none."""
    case, truth, network = todo
    task = task_of(case, network)
    if task is None:
        return None
    matches = refined_candidates(task, find_candidates(task).candidates)
    if not matches:
        return None
    at = GeoPoint(truth.lat_deg, truth.lon_deg, 0.0)
    crs = RasterMap.open(case.ortho, case.dsm).crs
    places = [crs.to_geo(*task.plan.frame.to_map(m.descended.pose.p_ned_m[:2])) for m in matches]
    apart = [distance_m(GeoPoint(lat, lon, 0.0), at) for lat, lon in places]
    return np.array([standing(task, m).regressors() for m in matches]), np.array(apart) < RIGHT_PX * task.ref.gsd_m


def task_of(case: Case, network: Path | None) -> Task | None:
    """A case as the dense localiser takes it up; `network`: None for gradient features, an empty path for the shipped one."""
    cv2.setNumThreads(1)
    pixels, ref = read_frame(case.frame), RasterMap.open(case.ortho, case.dsm)
    if pixels is None:
        return None
    model = case.camera.model(pixels)
    plan = make_plan(case.prior, model, ref, LocaliserSettings())
    if not isinstance(plan, SearchPlan):
        return None
    features: Features = GRADIENT if network is None else _network(network)
    return Task(plan, case.prior, full_level(pixels, model), ref, Stopwatch(), features, GRADIENT, DEEP_RANK, 1.0)


def fit(cases: list[Candidates], ridge: float = 0.3) -> Array:
    """Weights of the conditional logit by Newton's method, with a slight ridge on standardised regressors."""
    scale = np.maximum(np.concatenate([x - x.mean(0) for x, _ in cases]).std(0), 1e-9)
    weights = np.zeros(len(scale))
    for _ in range(50):
        gradient, hessian = -ridge * weights, ridge * np.eye(len(scale))
        for x, right in cases:
            z = x / scale
            p = np.exp(z @ weights - (z @ weights).max())
            p /= p.sum()
            q = p * right / max(float((p * right).sum()), 1e-12)
            gradient = gradient + z.T @ (q - p)
            mean = p @ z
            hessian = hessian + (z * p[:, None]).T @ z - np.outer(mean, mean)
        step = np.linalg.solve(hessian, gradient)
        weights = weights + step * min(1.0, 2.0 / np.abs(step).max())
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(weights / scale)


@lru_cache(maxsize=1)
def _network(folder: Path) -> Features:
    return open_features(folder if folder != Path() else None, threads=1)


if __name__ == "__main__":
    main()
