"""Fit what the localisers claim, on training data only: `python -m benchmarks.calibrate FOLDER [--jobs N]`.

Data: NAIP rows above 400 (cases t2, wide, low, oblique, elsewhere, blind) and the bi-temporal pairs. Prints the logistic
coefficients of localise/verify.py, and the ratio of errors to claimed sigmas for the covariance factor of localise/dense.py.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from benchmarks.cases import TRAINING_ROWS, CaseSet, make
from visloc_companion.evaluate.cases import read_cases, read_truth
from visloc_companion.evaluate.image import run_case
from visloc_companion.evaluate.image_metrics import CaseResult, case_error
from visloc_companion.localise.verify import Evidence

SETS = [
    CaseSet("t2", "t2", 200, TRAINING_ROWS, 101),
    CaseSet("wide", "wide", 150, TRAINING_ROWS, 102),
    *(CaseSet(f"low{foot}", "low", 120, TRAINING_ROWS, 103 + foot, foot=foot) for foot in (128, 96, 64, 48)),
    CaseSet("oblique", "oblique", 120, TRAINING_ROWS, 104),
    CaseSet("elsewhere", "elsewhere", 200, TRAINING_ROWS, 105, elsewhere="bitemporal/bragg_2006_2009"),
    CaseSet("elsewhere64", "elsewhere", 100, TRAINING_ROWS, 106, foot=64, elsewhere="bitemporal/bragg_2010_2014"),
    CaseSet("blind", "blind", 60, TRAINING_ROWS, 107),
    *(
        CaseSet(f"pair_{pair}", "t2", 25, ":", 108, dates=f"bitemporal/bragg_{pair}")
        for pair in ("2006_2009", "2006_2014", "2009_2012", "2010_2014", "2012_2014")
    ),
]


def main() -> None:
    """Make the cases, localise them with every answer accepted, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--method", default="gradient")
    parser.add_argument("--limit", type=int, help="cases of each set")
    args = parser.parse_args()
    x, y, whitened = [], [], []
    for case_set in SETS:
        folder = make(case_set, args.folder)
        cases, truth = read_cases(folder)[: args.limit], read_truth(folder)
        with ProcessPoolExecutor(args.jobs, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
            results = list(pool.map(run_case, cases, [args.method] * len(cases), [1.0] * len(cases)))
        errors = [(r, case_error(r, truth[r.case_id])) for r in results]
        right = [e for _, e in errors if e is not None and not e.wrong]
        px = np.array([e.horizontal_px for e in right])
        print(f"{case_set.name}: {len(right)} of {len(cases)} right, mean of these {px.mean() if len(px) else math.nan:.3f} px")
        x += [regressors(args.method, r) for r, e in errors if e is not None]
        y += [not e.wrong for _, e in errors if e is not None]
        if "pair" not in case_set.name:
            whitened += [e.sigmas for e in right]
    weights = fit_logistic(np.array(x), np.array(y, dtype=float))
    p_wrong = 1 / (1 + np.exp(np.array(x) @ weights))
    print("weights", tuple(float(f"{w:.3g}") for w in weights))
    print("rms(error / sigma) north, east, height:", np.sqrt((np.array(whitened) ** 2).mean(0)).round(2))
    robust = np.percentile(np.abs(np.array(whitened)), 68.3, axis=0).round(2)
    print("68 % of |error / sigma| below:", robust)
    for limit in (0.1, 0.03, 0.01, 0.003):
        taken = p_wrong <= limit
        wrong, right_taken = int((1 - np.array(y))[taken].sum()), np.array(y)[taken].sum() / np.sum(y)
        print(f"p <= {limit}: {taken.sum()} accepted, {wrong} wrong, {100 * right_taken:.1f} % of the right ones kept")


def regressors(method: str, result: CaseResult) -> tuple[float, ...]:
    """What the logistic regression of a method is on."""
    e = result.evidence
    if method == "keypoint":
        return 1.0, e["inliers"]
    if method == "ncc":
        return 1.0, e["score"], 1 - e["runner_up"]
    return Evidence.from_numbers(e).regressors()


def fit_logistic(x: np.ndarray, y: np.ndarray, ridge: float = 0.3) -> np.ndarray:
    """Weights of a logistic regression by Newton's method, with a slight ridge on all but the constant."""
    scale = np.append(1.0, np.maximum(x[:, 1:].std(0), 1e-9))
    x, weights = x / scale, np.zeros(x.shape[1])
    penalty = np.diag([0.0] + [ridge] * (x.shape[1] - 1))
    for _ in range(100):
        p = 1 / (1 + np.exp(-np.clip(x @ weights, -30, 30)))
        gradient = x.T @ (y - p) - penalty @ weights
        step = np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x + penalty + 1e-9 * np.eye(len(weights)), gradient)
        weights = weights + step * min(1.0, 3.0 / np.abs(step).max())
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(weights / scale)


if __name__ == "__main__":
    main()
