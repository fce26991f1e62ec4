"""Fit the temperature of the search's posterior: `python -m benchmarks.temperature FOLDER [--method NAME] [--n N] [--jobs N]`.

Maximum likelihood over training cases (localise/candidates/posterior.py). Prints the temperature times the footprint's side,
which is `Fitted.temperature` of localise/dense.py, and the mass that the best mode claims against how often it is right.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.image_cases.training_sets import SETS
from benchmarks.rank import RIGHT_PX, task_of
from visloc_companion.app.with_parent import end_with_parent
from visloc_companion.evaluate.cases import BadCase, Case, Truth, read_cases, read_truth
from visloc_companion.localise.candidates.hypotheses import region, search_box, search_window
from visloc_companion.localise.candidates.posterior import KnownPosition, fit_temperature, posterior
from visloc_companion.localise.mapped.window import cropped, map_grid

USED = ("low128", "low96", "low64", "low48", "pairs64", "land64")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", choices=("gradient", "deep"), default="deep")
    parser.add_argument("--n", type=int, default=40, help="cases of each set")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    model = None if args.method == "gradient" else Path()
    todo = []
    for name in USED:
        folder = SETS[name](args.folder / "cases")
        truth = read_truth(folder)
        todo += [(c, truth[c.case_id], model) for c in read_cases(folder)[: args.n] if not isinstance(c, BadCase)]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        samples = [s for s in pool.map(sample_of, todo, chunksize=4) if s is not None]
    factor = fit_temperature(samples)
    print(f"temperature x side: {factor:.3g} ({len(samples)} cases)")
    claimed, right = [], []
    for sample in samples:
        best = posterior(sample.volume, sample.allowed, factor * sample.unit).modes[0]
        claimed.append(best.mass)
        right.append(math.hypot(best.u_px - sample.true_px[0], best.v_px - sample.true_px[1]) < RIGHT_PX)
    print(f"the best mode claims {np.mean(claimed):.3f} on average and is right in {np.mean(right):.3f}")


def sample_of(todo: tuple[Case, Truth, Path | None]) -> KnownPosition | None:
    """Score volume and true position of a case; None where the truth lies outside of what is searched."""
    case, truth, network = todo
    task = task_of(case, network)
    if task is None:
        return None
    plan = task.plan
    low, high = search_box(plan)
    grid = cropped(map_grid(task.ref, plan.frame, low, high, plan.coarse_gsd_m, task.features))
    volume = search_window(grid, task.frame(grid, task.features), plan)
    allowed = region(volume, grid, plan)
    projection = task.ref.projection_at(case.prior.place)
    map_m = np.array(projection.origin_map_m) + np.asarray(projection.J_map_ne) @ _offset_m(case, truth)
    ne = np.linalg.solve(plan.frame.J_map_ne, map_m - plan.frame.origin_map)
    u, v = np.linalg.solve(grid.A_ne_pix[:, :2], ne - grid.A_ne_pix[:, 2])
    row, col = round(v - volume.origin_px[1]), round(u - volume.origin_px[0])
    inside = (
        0 <= row < allowed.shape[0] and 0 <= col < allowed.shape[1] and bool(allowed[row, col]) and volume.score[row, col] > 0
    )
    return KnownPosition(volume, allowed, (float(u), float(v)), grid.gsd_m / math.sqrt(plan.area_m2)) if inside else None


def _offset_m(case: Case, truth: Truth) -> np.ndarray:
    """Metres north and east of the truth from the prior's place (flat: hundreds of metres at most)."""
    place = case.prior.place
    north = math.radians(truth.lat_deg - place.lat_deg) * 6_367_449.0
    return np.array([north, math.radians(truth.lon_deg - place.lon_deg) * 6_378_137.0 * math.cos(math.radians(place.lat_deg))])


if __name__ == "__main__":
    main()
