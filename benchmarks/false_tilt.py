"""Fixes under an attitude that lies: `python -m benchmarks.false_tilt FOLDER [--method NAME] [--flat]`.

24 views of training worlds (landscape seeds 50 to 55, 100 to 300 m above ground), the prior drawn about the truth, and its tilt
off by so many sigmas in any direction, or heading or height by six. Prints how many are accepted, how far off (median, furthest)
and over what they claim. `--flat` takes the surface model away. FOLDER keeps the cases.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.image_cases.landscape_cases import Worlds, write_landscape
from benchmarks.image_cases.tilt_cases import without_model
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_cases, read_truth
from visloc_companion.evaluate.images.image import run_case
from visloc_companion.evaluate.images.image_metrics import CaseError, case_error
from visloc_companion.evaluate.images.map_sigma import MapSigma
from visloc_companion.geo.se3 import quat_from_euler, quat_from_vector, quat_multiply
from visloc_companion.geo.wgs84 import geo_from_ned
from visloc_companion.types import GeoPoint

WORLDS = Worlds(tuple(range(50, 56)), 4, gsds_m=(0.5, 1.0, 1.4), foot_px=230)
PLACE_M, HEIGHT_M, YAW_DEG = 5.0, 3.0, 2.5
"""1-sigma of the prior."""
TILT_DEG, TILT_SIGMAS = (0.3, 0.5, 1.0), (0, 1, 2, 4, 6, 10)
"""1-sigma that is claimed of the tilt, and by how many the tilt is off; 0: drawn honestly."""
OTHER_SIGMAS, OTHERS_TILT_DEG = 6.0, 0.5
EXACT = MapSigma(0.0, 0.0)


def main() -> None:
    """Make the cases, lie, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", default="deep")
    parser.add_argument("--flat", action="store_true", help="without the surface model")
    args = parser.parse_args()
    folder = write_landscape(args.folder / "views", WORLDS)
    if args.flat:
        folder = without_model(folder, args.folder / "flat")
    lies = [("tilt", sigmas, deg) for deg in TILT_DEG for sigmas in TILT_SIGMAS]
    for what, sigmas, deg in [*lies, *((other, OTHER_SIGMAS, OTHERS_TILT_DEG) for other in ("yaw", "height"))]:
        print(
            f"{what} off by {sigmas:.0f} sigma, tilt known to {deg}: {_words(judged(folder, args.method, what, sigmas, deg))}",
            flush=True,
        )


def judged(folder: Path, method: str, what: str, sigmas: float, tilt_deg: float) -> list[CaseError | None]:
    """Error of every case whose prior lies so, None where it is refused."""
    truths = read_truth(folder)
    found = []
    for number, case in enumerate(read_cases(folder)):
        if isinstance(case, BadCase):
            raise SystemExit(f"{folder}: {case.case_id} {case.why}")
        truth = truths[case.case_id]
        found.append(case_error(run_case(lying(case, truth, number, what, sigmas, tilt_deg), method, map_sigma=EXACT), truth))
    return found


def lying(case: Case, truth: Truth, number: int, what: str, sigmas: float, tilt_deg: float) -> Case:
    """The case with a prior about the truth of which `what` (tilt, yaw, height) is off by so many sigmas, the rest as claimed."""
    rng = np.random.default_rng([number, 7])
    north, east, down = (rng.normal(0, 1, 3) * (PLACE_M, PLACE_M, HEIGHT_M)).tolist()
    draws, direction = rng.normal(0, 1, 3), float(rng.uniform(0, 2 * math.pi))
    tilt, yaw = draws[:2], float(draws[2])
    if what == "tilt" and sigmas > 0:
        tilt = sigmas * np.array([math.cos(direction), math.sin(direction)])
    yaw = sigmas if what == "yaw" else yaw
    down = -sigmas * HEIGHT_M if what == "height" else down
    turn = (*np.radians(tilt * tilt_deg).tolist(), math.radians(yaw * YAW_DEG))
    upright = quat_from_euler(*(math.radians(a) for a in (truth.roll_deg, truth.pitch_deg, truth.yaw_deg)))
    prior = replace(
        case.prior,
        place=geo_from_ned((north, east, down), GeoPoint(truth.lat_deg, truth.lon_deg, truth.h_m)),
        q_ned_frd=quat_multiply(quat_from_vector(turn), upright),
        cov_ne_m2=((PLACE_M**2, 0.0), (0.0, PLACE_M**2)),
        sigma_h_m=HEIGHT_M,
        sigma_yaw_rad=math.radians(YAW_DEG),
        sigma_tilt_rad=math.radians(tilt_deg),
    )
    return replace(case, prior=prior)


def _words(errors: list[CaseError | None]) -> str:
    fixes = [error for error in errors if error is not None]
    if not fixes:
        return f"0 of {len(errors)} accepted"
    off_m, chi2 = np.array([e.horizontal_m for e in fixes]), np.array([e.chi2 for e in fixes])
    return (
        f"{len(fixes)} of {len(errors)} accepted, {np.median(off_m):.2f} m off (furthest {off_m.max():.1f}), over sigma "
        f"{math.sqrt(chi2.mean() / 2):.2f} an axis, tilt {np.median([e.tilt_deg for e in fixes]):.2f} deg off"
    )


if __name__ == "__main__":
    main()
