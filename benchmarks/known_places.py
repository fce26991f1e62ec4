"""What the image localiser claims where the place is known to a pixel or two, as in flight: `python -m benchmarks.known_places
FOLDER [--sets ...] [--n N] [--method NAME] [--training]`.

The cases of the table with another prior: right within its stated sigma, or beside the truth by more than is searched though it
states the same. In the second nothing that is found can be right, and what is accepted is wrong. One row for each set and prior.
`--training` takes the sets that claims are fitted on instead.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.image_cases import sets, training_sets
from benchmarks.image_cases.answers import UNSTATED, Judged, answers, code_digest
from benchmarks.image_cases.cases import read_table, write_tables
from benchmarks.image_cases.sets import MAP_SIGMAS
from benchmarks.table import figure, share
from visloc_companion.evaluate.images.image import MAX_PROBABILITY_WRONG
from visloc_companion.evaluate.images.image_metrics import case_error
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import GeoPoint

SIGMA_PX, TILT_DEG, HEADING_DEG, HEIGHT_SHARE = 1.0, 0.5, 5.0, 0.25
"""1-sigma of the prior on each axis (map pixels), of its tilt and heading; of its height, as a share of the case's."""
BESIDE_PX = (12.0, 40.0)
"""How far a wrong prior lies beside the truth: beyond what is searched, and over other ground in part."""
PRIORS = ("right", "beside")
HEADER = "| cases | prior | n | < 5 px | accepted, right | accepted, far | wrong, claimed | wrong | ECE |"


def main() -> None:
    """Make, answer, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", nargs="+", default=["low96", "low64", "low48"])
    parser.add_argument("--n", type=int, default=100)
    parser.add_argument("--method", default="deep")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--training", action="store_true")
    args = parser.parse_args()
    makers = training_sets.SETS if args.training else sets.SETS
    digest, kind = code_digest(None, without_verdict=True), "training" if args.training else "scored"
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    for name in args.sets:
        source = makers[name](args.folder / kind)
        for prior in PRIORS:
            folder = told(source, args.folder / f"{kind}_{prior}" / name, beside=prior == "beside", n=args.n)
            sigma, store = MAP_SIGMAS.get(name, UNSTATED), args.folder / f"answers_{kind}_{prior}"
            judged = answers(folder, args.method, store, digest, args.jobs, args.n, map_sigma=sigma)
            print(row(name, prior, judged), flush=True)


def told(source: Path, folder: Path, *, beside: bool, n: int) -> Path:
    """The first `n` cases of a folder with the place told to SIGMA_PX, or to somewhere beside it."""
    if (folder / "cases.csv").exists():
        return folder
    rng = np.random.default_rng([len(source.name), *source.name.encode(), beside])
    pairs = list(zip(read_table(source / "cases.csv"), read_table(source / "truth.csv"), strict=True))[:n]
    cases = [_told(case, truth, source, beside, rng) for case, truth in pairs]
    folder.mkdir(parents=True, exist_ok=True)
    return write_tables(folder, cases, [truth for _, truth in pairs])


def _told(case: dict[str, Any], truth: Mapping[str, Any], source: Path, beside: bool, rng: np.random.Generator) -> dict[str, Any]:
    sigma_m, sigma_h_m = SIGMA_PX * float(truth["gsd_m"]), HEIGHT_SHARE * float(case["sigma_h_m"])
    north, east = rng.normal(0, sigma_m, 2).tolist()
    if beside:
        off_m, towards = rng.uniform(*BESIDE_PX) * float(truth["gsd_m"]), rng.uniform(0, 2 * math.pi)
        north, east = off_m * math.cos(towards), off_m * math.sin(towards)
    lat, lon, h_m = (float(truth[k]) for k in ("lat_deg", "lon_deg", "h_m"))
    at = geo_from_ned((north, east, 0.0), GeoPoint(lat, lon, h_m))
    roll, pitch = (float(truth[k]) + rng.normal(0, TILT_DEG) for k in ("roll_deg", "pitch_deg"))
    return case | {
        "frame": str((source / case["frame"]).resolve()),
        "prior_lat_deg": at.lat_deg,
        "prior_lon_deg": at.lon_deg,
        "prior_h_m": h_m + rng.normal(0, sigma_h_m),
        "prior_roll_deg": roll,
        "prior_pitch_deg": pitch,
        "prior_yaw_deg": (float(truth["yaw_deg"]) + rng.normal(0, HEADING_DEG)) % 360,
        "sigma_horizontal_m": sigma_m,
        "sigma_h_m": sigma_h_m,
        "sigma_yaw_deg": HEADING_DEG,
        "sigma_tilt_deg": TILT_DEG,
    }


def row(name: str, prior: str, judged: list[Judged]) -> str:
    """One row of the table: shares of all cases, claims of all answers."""
    pairs = [(r.fix.probability_wrong, e) for r, t in judged if r.fix is not None and (e := case_error(r, t)) is not None]
    taken = [e for p, e in pairs if p <= MAX_PROBABILITY_WRONG]
    claimed, wrong = np.array([p for p, _ in pairs]), np.array([e.wrong for _, e in pairs], dtype=bool)
    cells = [
        *(name, prior, len(judged)),
        share(sum(not e.wrong for _, e in pairs) / len(judged)),
        share(sum(not e.far for e in taken) / len(judged)),
        sum(e.far for e in taken),
        *(figure(float(claimed.sum()), 1), int(wrong.sum())),
        figure(reliability(claimed, wrong)["expected_calibration_error"], 3),
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


if __name__ == "__main__":
    main()
