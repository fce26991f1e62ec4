"""Other cameras, other maps: what a localiser makes of them, and whether it says so where it cannot.

    python -m benchmarks.sensors FOLDER [--n 40] [--foot 128] [--method deep] [--only grey ...] [--skip frames maps photos]

Prints one markdown table. Its rows are the same `--n` sites, dates and priors with the camera or the map varied, and photographs
of a town (benchmarks/image_cases/sensor_cases.py, sensor_photos.py). FOLDER keeps cases and answers. Accepted are answers that
claim at most 5 % of being wrong, as by default. Far is off by more than 10 px (of 5 m, of 1 m for the photographs), or any answer
where none is right. Errors and their ratio to the claim (root mean square, both axes) are those of the accepted and right.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from benchmarks.image_cases.answers import Judged, answers, code_digest
from benchmarks.image_cases.sensor_cases import SIZES, of_frames, of_maps
from benchmarks.image_cases.sensor_maps import MAPS
from benchmarks.image_cases.sensor_photos import PHOTOS, of_photos
from benchmarks.image_cases.sensor_variations import FRAMES
from visloc_companion.evaluate.images.image import MAX_PROBABILITY_WRONG
from visloc_companion.evaluate.images.image_metrics import accepted, case_error
from visloc_companion.localise.registry import METHODS

COLUMNS = "varied", "n", "accepted, right", "accepted, far", "refused", "px mean", "error over sigma", "why refused"


def main() -> None:
    """Make, answer, print."""
    args = _arguments()
    cv2.setNumThreads(1)
    digest = code_digest(None, without_verdict=True)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}", flush=True)
    kinds = ("frames", of_frames, [*FRAMES, *SIZES]), ("maps", of_maps, list(MAPS)), ("photos", of_photos, list(PHOTOS))
    for kind, make, names in kinds:
        for name in names:
            if kind in args.skip or (args.only and name not in args.only):
                continue
            folder = make(args.folder / "cases" / f"{args.foot:g}", name, args.n, args.foot)
            judged = answers(folder, args.method, args.folder / "answers" / f"{args.foot:g}", digest, limit=args.n)
            print(row(f"{kind.removesuffix('s')}: {name}", judged), flush=True)


def row(name: str, judged: list[Judged]) -> str:
    """The line of the table."""
    taken = accepted([result for result, _ in judged], MAX_PROBABILITY_WRONG)
    errors = [e for result, (_, truth) in zip(taken, judged, strict=True) if (e := case_error(result, truth)) is not None]
    right = [e for e in errors if not e.far]
    why = Counter(str(result.reason) for result in taken if result.reason is not None)
    off, over = "–", "–"
    if right:
        off = f"{np.mean([e.horizontal_px for e in right]):.2f}"
        over = f"{np.sqrt(np.mean([s**2 for e in right for s in e.sigmas[:2]])):.2f}"
    reasons = ", ".join(f"{reason} {n}" for reason, n in why.most_common(3)) or "–"
    counts = len(judged), len(right), len(errors) - len(right), sum(why.values())
    return f"| {name} | {' | '.join(map(str, counts))} | {off} | {over} | {reasons} |"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n", type=int, default=40, help="sites of each row")
    parser.add_argument("--foot", type=float, default=128, help="footprint of a frame, pixels of the map")
    parser.add_argument("--method", choices=METHODS, default="deep")
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--skip", nargs="+", default=[], choices=["frames", "maps", "photos"])
    return parser.parse_args()


if __name__ == "__main__":
    main()
