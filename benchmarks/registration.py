"""How far two dates of the training places are apart in metres: `python -m benchmarks.registration`.

What a position against a map is off by although frame and map are matched perfectly. Shifts between the dates are measured in
windows, image against image (`benchmarks.floor`), at NAIP rows < 400 and on the bi-temporal pairs whose years trained the
network; for the pairs the shift that a whole image has is taken out, as in the cases made of them. `of the cases` also counts by
how much the shift that the cases use (one correlation of the whole images) differs from that.
"""

from __future__ import annotations

import argparse
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.floor import SIGMAS_PX, Windows, closure_noise, dated_features, featured, grid_shifts
from benchmarks.image_cases.cases import SHARED, maker
from benchmarks.image_cases.frames import whole_shift_px

TRAINED_YEARS = ("2006", "2009", "2010", "2012")
PAIR_GSD_M, NAIP_GSD_M = 1.0, 5.0
Array = NDArray[np.float64]
Dates = dict[str, NDArray[np.float32]]


def main() -> None:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    cv2.setNumThreads(1)
    print("| dates | m a pixel | windows | pairs | east, m | north, m | an axis, m | noise, m |")
    print("|---|---|---|---|---|---|---|---|")
    naip = grid_shifts(dated_features(SIGMAS_PX[1]), Windows((0, 400), 173, 60))
    print(row("NAIP, rows < 400", naip, naip, NAIP_GSD_M), flush=True)
    images = pair_images()
    dates = {year: featured(image, SIGMAS_PX[1]) for year, image in images.items()}
    shifts = grid_shifts(dates, Windows((0, min(i.shape[0] for i in images.values())), 128, 40))
    own = {pair: s - np.median(s, axis=0) for pair, s in shifts.items()}
    print(row("pairs, less the median shift", own, shifts, PAIR_GSD_M), flush=True)
    cases = {(a, b): s - whole_shift_px(images[a], images[b]) for (a, b), s in shifts.items()}
    print(row("pairs, less that of the cases", cases, shifts, PAIR_GSD_M), flush=True)


def pair_images() -> dict[str, NDArray[np.uint8]]:
    """The bi-temporal images of the trained years, by year."""
    images = {}
    for a, b in combinations(TRAINED_YEARS, 2):
        for year, name in ((a, "a"), (b, "b")):
            images[year] = maker().read(SHARED / "data" / "bitemporal" / f"bragg_{a}_{b}" / f"{name}.tif")[0]
    return images


def row(name: str, left: dict[tuple[str, str], Array], shifts: dict[tuple[str, str], Array], gsd_m: float) -> str:
    """Root mean squares of what is left of the shifts (windows, 2), less the noise of one measurement."""
    noise_px = closure_noise(shifts, sorted({name for pair in shifts for name in pair}))
    east, south = (np.concatenate(list(left.values())) ** 2).mean(0)
    axes = [gsd_m * float(np.sqrt(max(v - noise_px**2, 0.0))) for v in (east, south, (east + south) / 2)]
    windows = len(next(iter(left.values())))
    figures = " | ".join(f"{v:.2f}" for v in (*axes, noise_px * gsd_m))
    return f"| {name} | {gsd_m:g} | {windows} | {len(left)} | {figures} |"


if __name__ == "__main__":
    main()
