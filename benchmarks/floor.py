"""How far the NAIP dates themselves are apart: `python -m benchmarks.floor FOLDER [--methods gradient ...] [--n N] [--jobs N]`.

The local shift between two dates, at rows >= 400, is measured directly, image against image, without a camera: a window of the
size of T2's footprint of one date is looked for within ±5 px on the other, by correlation of gradient orientation.

Closure of triangles says how good that is: shifts A to B, B to C and C to A must add up to nothing, so a third of the variance of
their sum is that of one measurement (what a date does to all its measurements cancels, as its misregistration does).

The localiser's answers to the cases of T2 (`benchmarks/table.py` keeps them in FOLDER) are then compared with the shift at the
same place: what is left is the localiser's own error.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.image_cases.answers import answers, code_digest
from benchmarks.image_cases.cases import SHARED, maker
from benchmarks.image_cases.frames import georeference, pix_of
from benchmarks.image_cases.sets import SCORED_ROWS, SETS
from benchmarks.image_cases.shift import REACH_PX, shift_px
from visloc_companion.evaluate.images.image_metrics import case_error
from visloc_companion.localise.features.gradient import gradient_features

SIDE_PX, SPACING_PX = 173, 80
SIGMAS_PX = (0.0, 1.0, 2.0)
"""Roads weigh most in sharp features; shores and edges of fields, which move, in smooth ones. The second is align.py's own."""
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows of a side on a grid over some rows of an image."""

    rows: tuple[int, int] = SCORED_ROWS
    side_px: int = SIDE_PX
    spacing_px: int = SPACING_PX


SCORED = Windows()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--methods", nargs="*", default=["gradient"])
    parser.add_argument("--n", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    print("| smoothing px | n | mean shift px | median | noise of one measurement, an axis, px | rms shift less noise px |")
    print("|---|---|---|---|---|---|")
    for sigma_px in SIGMAS_PX:
        print(_floor_row(sigma_px, grid_shifts(dated_features(sigma_px))), flush=True)
    dates = dated_features(SIGMAS_PX[1])
    print("\n| method | n | mean error px | mean shift of the dates there px | excess px | mean error less that shift px |")
    print("|---|---|---|---|---|---|")
    folder = SETS["t2"](args.folder / "cases")
    for method in args.methods:
        print(_against_floor(method, folder, args, dates))


def dated_features(sigma_px: float) -> dict[str, NDArray[np.float32]]:
    """Gradient features (H, W, 2) of every date, by its name, smoothed by a Gaussian of `sigma_px`."""
    files = sorted((SHARED / "data" / "naip").glob("*.tif"))
    return {path.stem: featured(maker().read(path)[0], sigma_px) for path in files}


def featured(image: NDArray[np.uint8], sigma_px: float) -> NDArray[np.float32]:
    """Gradient features (H, W, 2) of an image, smoothed by a Gaussian of `sigma_px`."""
    features = gradient_features(image, np.ones(image.shape[:2], dtype=np.bool_))
    return cv2.GaussianBlur(features, (0, 0), sigma_px).astype(np.float32) if sigma_px else features


def grid_shifts(dates: dict[str, NDArray[np.float32]], windows: Windows = SCORED) -> dict[tuple[str, str], Array]:
    """Shifts (windows, 2) of all pairs of dates (a before b), at windows on a grid.

    A window of a pair counts only where it is determined for all pairs, so that triangles close at every window.
    """
    half = windows.side_px // 2 + REACH_PX + 1
    height, width = next(iter(dates.values())).shape[:2]
    centres = [
        (float(col), float(row))
        for row in range(max(windows.rows[0], half), min(windows.rows[1], height) - half, windows.spacing_px)
        for col in range(half, width - half, windows.spacing_px)
    ]
    raw = {
        (a, b): [shift_px(dates[a], dates[b], centre, windows.side_px) for centre in centres]
        for a, b in combinations(sorted(dates), 2)
    }
    known = np.all([[shift is not None for shift in row] for row in raw.values()], axis=0)
    return {pair: np.array([s for s, k in zip(row, known, strict=True) if k and s is not None]) for pair, row in raw.items()}


def closure_noise(shifts: dict[tuple[str, str], Array], names: list[str]) -> float:
    """Standard deviation (px, one axis) of one measured shift, from the triangles of all triples of dates."""
    sums = [shifts[a, b] + shifts[b, c] - shifts[a, c] for a, b, c in combinations(names, 3)]
    return float(np.sqrt((np.concatenate(sums) ** 2).mean() / 3))


def _floor_row(sigma_px: float, shifts: dict[tuple[str, str], Array]) -> str:
    d = np.concatenate(list(shifts.values()))
    noise = closure_noise(shifts, sorted({name for pair in shifts for name in pair}))
    length = np.hypot(*d.T)
    clean = float(np.sqrt(max((length**2).mean() - 2 * noise**2, 0.0)))
    return f"| {sigma_px:g} | {len(d)} | {length.mean():.3f} | {np.median(length):.3f} | {noise:.3f} | {clean:.3f} |"


def _against_floor(method: str, folder: Path, args: argparse.Namespace, dates: dict[str, NDArray[np.float32]]) -> str:
    georeferenced = georeference(next(iter((SHARED / "data" / "naip").glob("*.tif"))))
    found = []
    for result, truth in answers(folder, method, args.folder / "answers", code_digest(None), args.jobs, args.n):
        error = case_error(result, truth)
        centre = pix_of(georeferenced, truth.lat_deg, truth.lon_deg)
        shift = shift_px(dates[truth.frame_date], dates[truth.map_date], centre, SIDE_PX)
        if error is not None and not error.wrong and shift is not None:
            found.append([error.east_m / error.gsd_m, -error.north_m / error.gsd_m, *shift])
    if not found:
        return f"| {method} | 0 |  |  |  |  |"
    errors, shifts = np.hsplit(np.array(found), 2)
    mean_error, mean_shift, own = (float(np.hypot(*v.T).mean()) for v in (errors, shifts, errors - shifts))
    return f"| {method} | {len(errors)} | {mean_error:.3f} | {mean_shift:.3f} | {mean_error - mean_shift:+.3f} | {own:.3f} |"


if __name__ == "__main__":
    main()
