"""Fit what `iclk` and `mi` claim, on training data only: `python -m benchmarks.calibrate_baselines FOLDER [--method mi] [--n N]`.

Data: NAIP rows above 400 and, for frames of another place, a bi-temporal pair. Prints the logistic weights of the method's
`probability_wrong`, and the ratio of errors to claimed sigmas. `--gradient` fits `iclk` on gradient features instead of the
shipped network's.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from benchmarks.calibrate import fit_logistic
from benchmarks.image_cases.cases import TRAINING_ROWS, CaseSet, make
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_cases, read_frame, read_truth
from visloc_companion.evaluate.images.image_metrics import CaseError, CaseResult, case_error
from visloc_companion.localise import iclk, mutual_information
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.features.onnx import open_features
from visloc_companion.localise.registry import make_localiser
from visloc_companion.maps.raster import RasterMap
from visloc_companion.types import Fix, FrameRef, LocaliseRequest

REGRESSORS = {"iclk": iclk.regressors, "mi": mutual_information.regressors}


def sets(n: int) -> list[CaseSet]:
    """Half of them solvable at all, the wide prior hardly by descent alone."""
    pair = "bitemporal/bragg_2006_2009"
    return [
        CaseSet("fit_t2", "t2", n, TRAINING_ROWS, 911),
        *(CaseSet(f"fit_low{foot}", "low", n // 2, TRAINING_ROWS, 912 + foot, foot=foot) for foot in (128, 96, 64)),
        CaseSet("fit_oblique", "oblique", n // 2, TRAINING_ROWS, 913),
        CaseSet("fit_elsewhere", "elsewhere", n // 2, TRAINING_ROWS, 914, elsewhere=pair),
    ]


def main() -> None:
    """Make the cases, localise them with every answer accepted, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", choices=REGRESSORS, default="iclk")
    parser.add_argument("--n", type=int, default=120)
    parser.add_argument("--gradient", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    features = None if args.method == "mi" else GRADIENT if args.gradient else open_features()
    x, y, whitened = [], [], []
    for case_set in sets(args.n):
        folder = make(case_set, args.folder)
        truth = read_truth(folder)
        judged = [
            judged_case for c in read_cases(folder)[: case_set.n] if (judged_case := answer(c, args.method, features, truth))
        ]
        right = [e for _, e in judged if not e.wrong]
        whitened += [e.sigmas for e in right]
        mean_px = np.mean([e.horizontal_px for e in right]) if right else np.nan
        print(f"{case_set.name}: {len(right)} of {len(judged)} right, mean of these {mean_px:.2f} px", flush=True)
        x += [REGRESSORS[args.method](r.evidence) for r, _ in judged]
        y += [float(not e.wrong) for _, e in judged]
    table, right_or_not = np.array(x), np.array(y)
    weights = fit_logistic(table, right_or_not)
    p_wrong = 1 / (1 + np.exp(table @ weights))
    print("weights", tuple(float(f"{w:.3g}") for w in weights))
    print("rms(error / sigma) north, east, height:", np.sqrt((np.array(whitened) ** 2).mean(0)).round(2))
    print("68 % of |error / sigma| below:", np.percentile(np.abs(np.array(whitened)), 68.3, axis=0).round(2))
    for limit in (0.1, 0.05, 0.01):
        taken = p_wrong <= limit
        kept = right_or_not[taken].sum() / right_or_not.sum()
        wrong = int((1 - right_or_not)[taken].sum())
        print(f"p <= {limit}: {taken.sum()} accepted, {wrong} wrong, {100 * kept:.0f} % of the right kept")


def answer(
    case: Case | BadCase, method: str, features: Features | None, truth: dict[str, Truth]
) -> tuple[CaseResult, CaseError] | None:
    """What the method says of a case however little it believes it, and its error; None where it has nothing to say."""
    pixels = None if isinstance(case, BadCase) else read_frame(case.frame)
    if isinstance(case, BadCase) or pixels is None:
        raise SystemExit(f"{case.case_id} cannot be read")
    model = case.camera.model(pixels)
    localiser = make_localiser(method, model, features=features, max_probability_wrong=1.0)
    request = LocaliseRequest(0, FrameRef(0, 0, 0, 0, model.width_px, model.height_px, 3), case.prior, 1)
    fix = localiser.localise(request, pixels, reference := RasterMap.open(case.ortho, case.dsm))
    if not isinstance(fix, Fix):
        return None
    result = CaseResult(case.case_id, fix, None, evidence=dict(fix.evidence), map_gsd_m=reference.gsd_m)
    error = case_error(result, truth[case.case_id])
    return (result, error) if error else None


if __name__ == "__main__":
    main()
