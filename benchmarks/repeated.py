"""Does a wrong match say itself again? `python -m benchmarks.repeated FOLDER [--foots 40 48] [--n N] [--scored] [--jobs N]`.

core/filter/separation.py needs the probability that the next fix of a method errs with the last one, by how far the vehicle went
on between them. Frames of ../shared/data/naip of one date are localised on the map of another, from so low that wrong matches
occur. Where an answer is wrong (more than WRONG_PX off) and claims at most each of LIMITS, the vehicle goes on by a share of the
footprint, in any direction, and looks again: noise and brightness are new, heading and height nearly the same, what the prior
says wrong of them is as it was. The new prior lies where the wrong answer leads to, as a filter's does that took it. Counted is
what the second answer says that claims no more than the limit: the same place again (within SAME_PX of where the first leads to),
another wrong one, the right one, or nothing. Rows < 400 are those that the networks were trained and the claims fitted on; with
--scored rows >= 400. FOLDER keeps cases and answers.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.image_cases.answers import UNSTATED, Judged, answers, code_digest
from benchmarks.image_cases.cases import SHARED, TEST_ROWS, TRAINING_ROWS, CaseSet, make, maker, read_table, write_tables
from benchmarks.image_cases.frames import georeference, lon_lat, pix_of, write_frame
from benchmarks.table import share
from visloc_companion.types import Fix, FloatArray

SHARES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
LIMITS = (0.5, 0.2, 0.05)
WRONG_PX, SAME_PX = 10.0, 4.0
SIGMA_PX, DRAWN_PX = 5.0, 2.0
"""1-sigma of the second prior, and how far it lies from where the first answer leads to, on each axis."""
YAW_DEG, HEIGHT_SHARE = 1.0, 0.01
"""How heading and height of the second frame differ, 1-sigma."""
KINDS = ("same", "wrong", "right", "none")


def main() -> None:
    """Make, answer, count, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--foots", nargs="+", type=float, default=[40.0, 48.0])
    parser.add_argument("--method", default="deep")
    parser.add_argument("--n", type=int, default=1000, help="first frames of each footprint")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--scored", action="store_true", help="rows >= 400")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    digest = code_digest(None, without_verdict=True)
    counted: Counter[tuple[float, float, str]] = Counter()
    rows, place = (TEST_ROWS, "scored") if args.scored else (TRAINING_ROWS, "training")
    for foot in args.foots:
        first = make(CaseSet(f"{place}{foot:g}_{args.seed}", "low", args.n, rows, args.seed, foot=foot), args.folder / "cases")
        judged = answers(first, args.method, args.folder / "answers", digest, args.jobs, None, None, UNSTATED)
        seconds = again(first, judged, foot, args.seed, args.method)
        if seconds is None:
            continue
        answered = answers(seconds, args.method, args.folder / "answers", digest, args.jobs, None, None, UNSTATED)
        count(answered, seconds, counted)
    print(f"| limit | on by | n | {' | '.join(KINDS)} |\n|{'---|' * (3 + len(KINDS))}")
    for limit in LIMITS:
        for on_by in SHARES:
            n = sum(counted[limit, on_by, kind] for kind in KINDS)
            cells = [f"{limit:g}", f"{on_by:g}", str(n), *(share(counted[limit, on_by, k] / n) if n else "" for k in KINDS)]
            print(f"| {' | '.join(cells)} |")


def again(first: Path, judged: list[Judged], foot: float, seed: int, method: str) -> Path | None:
    """A folder of second looks after all wrong answers of a folder; None where there is none."""
    out = first.with_name(f"{first.name}_{method}_again")
    if (out / "cases.csv").exists():
        return out
    rng = np.random.default_rng([seed, round(foot)])
    cases = {case["id"]: case for case in read_table(first / "cases.csv")}
    truths = {truth["id"]: truth for truth in read_table(first / "truth.csv")}
    (out / "frames").mkdir(parents=True, exist_ok=True)
    found: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for result, _ in judged:
        name = result.case_id.rpartition("/")[2]
        case, truth = cases[name], truths[name]
        on = georeference(Path(case["ortho"]))
        if result.fix is None or result.fix.probability_wrong > max(LIMITS):
            continue
        at, off = off_px(on, truth, result.fix)
        if math.hypot(*off) > WRONG_PX:
            known = {"off_col": off[0], "off_row": off[1], "claimed": result.fix.probability_wrong}
            found += [each for on_by in SHARES if (each := second(out, case, truth, on, at, known, on_by, foot, rng))]
    return write_tables(out, [case for case, _ in found], [truth for _, truth in found]) if found else None


def off_px(on: tuple[Any, Any], truth: Mapping[str, Any], fix: Fix) -> tuple[FloatArray, FloatArray]:
    """(2,) column and row of where a camera is on the map, and by how much a fix is off."""
    at = np.array(pix_of(on, float(truth["lat_deg"]), float(truth["lon_deg"])))
    return at, np.array(pix_of(on, fix.place.lat_deg, fix.place.lon_deg)) - at


@cache
def scene_of(date: str) -> NDArray[Any]:
    """(H, W, 3) RGB of a date."""
    return np.asarray(maker().read(SHARED / "data" / "naip" / f"{date}.tif")[0])


def second(
    out: Path,
    case: Mapping[str, Any],
    truth: Mapping[str, Any],
    on: tuple[Any, Any],
    at: FloatArray,
    known: Mapping[str, float],
    on_by: float,
    foot: float,
    rng: np.random.Generator,
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The case of a second look and its truth; None where the frame would leave the scene."""
    tool, angle = maker(), rng.uniform(0, 2 * math.pi)
    scene = scene_of(truth["frame_date"])
    there = at + on_by * foot * np.array([math.cos(angle), math.sin(angle)])
    lon, lat = lon_lat(*on, there)
    turned, higher = rng.normal(0, YAW_DEG), float(rng.normal(1, HEIGHT_SHARE))
    yaw, height = float(truth["yaw_deg"]) + turned, float(truth["h_m"]) * higher
    to_pix = tool.pix_per_metre(*on, lat, lon)
    frame, coverage = tool.render(scene, there, to_pix, height, tool.R_ned_frd(yaw, 0.0, 0.0))
    if coverage < 0.97:
        return None
    name = f"{case['id']}_{on_by:g}"
    write_frame(out / "frames" / f"{name}.png", frame, rng)
    led_to = there + np.array([known["off_col"], known["off_row"]]) + rng.normal(0, DRAWN_PX, 2)
    prior_lon, prior_lat = lon_lat(*on, led_to)
    prior = {
        **{"id": name, "frame": f"frames/{name}.png", "prior_lat_deg": prior_lat, "prior_lon_deg": prior_lon},
        **{"prior_h_m": float(case["prior_h_m"]) * higher, "prior_yaw_deg": (float(case["prior_yaw_deg"]) + turned) % 360},
        "sigma_horizontal_m": SIGMA_PX * float(truth["gsd_m"]),
    }
    is_at = {"id": name, "lat_deg": lat, "lon_deg": lon, "h_m": height, "yaw_deg": yaw, **known, "on_by": on_by}
    return {**case, **prior}, {**truth, **is_at}


def count(answered: list[Judged], folder: Path, counted: Counter[tuple[float, float, str]]) -> None:
    """Add what second answers say under each limit, where the first one claimed no more either."""
    truths = {truth["id"]: truth for truth in read_table(folder / "truth.csv")}
    orthos = {case["id"]: Path(case["ortho"]) for case in read_table(folder / "cases.csv")}
    for result, _ in answered:
        name = result.case_id.rpartition("/")[2]
        truth, on = truths[name], georeference(orthos[name])
        for limit in LIMITS:
            if float(truth["claimed"]) > limit:
                continue
            kind = "none"
            if result.fix is not None and result.fix.probability_wrong <= limit:
                _, off = off_px(on, truth, result.fix)
                led_to = off - (float(truth["off_col"]), float(truth["off_row"]))
                kind = "same" if math.hypot(*led_to) <= SAME_PX else "right" if math.hypot(*off) <= WRONG_PX else "wrong"
            counted[limit, float(truth["on_by"]), kind] += 1


if __name__ == "__main__":
    main()
