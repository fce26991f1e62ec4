"""What more dates in the map are worth: `python -m benchmarks.dates FOLDER [--sets low48 low64] [--others 0 1 2 4 8] [--n N]`.

Frames of ../shared/data/naip, each localised over packs of other years: the year after the frame's (the last one's is the first)
and so many of those that follow; never the frame's own. Sets are those of `benchmarks.table` (rows >= 400), with `--training`
those of `benchmarks.image_cases.training_sets` (rows < 400). FOLDER keeps cases, packs and answers.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from benchmarks.image_cases import sets, training_sets
from benchmarks.image_cases.answers import UNSTATED, answers, code_digest
from benchmarks.image_cases.cases import read_table, write_tables
from benchmarks.table import figure, figures, share
from visloc_companion.prepare.build import build_pack
from visloc_companion.prepare.shipped import shipped_networks

LIMIT_P = 0.05


def main() -> None:
    """Make, answer, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", nargs="+", default=["low48", "low64"])
    parser.add_argument("--others", nargs="+", type=int, default=[0, 1, 2, 4, 8])
    parser.add_argument("--method", default="deep")
    parser.add_argument("--n", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--training", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    digest = code_digest(None, without_verdict=True)
    makers = training_sets.SETS if args.training else sets.SETS
    print("| cases | dates | n | < 15 px | < 5 px | < 2 px | mean px | accepted, right | accepted, far | in 95 % ellipse | ECE |")
    print(f"|{'---|' * 11}", flush=True)
    for name in args.sets:
        made = makers[name](args.folder / ("training" if args.training else "cases"))
        for n_others in args.others:
            cases = over_packs(made, args.folder, n_others)
            judged = answers(cases, args.method, args.folder / "answers", digest, args.jobs, args.n, None, UNSTATED)
            s = figures(judged, LIMIT_P)
            cells = [name, str(1 + n_others), str(s["n"]), *(share(s[f"within_{limit}px_share"]) for limit in (15, 5, 2))]
            cells += [figure((s["error_px"] or {}).get("mean")), share(s["accepted_right_share"]), str(s["accepted_far"])]
            cells += [share(s["inside_95_ellipse_share"]), f"{s['expected_calibration_error']:.3f}"]
            print(f"| {' | '.join(cells)} |", flush=True)


def over_packs(made: Path, folder: Path, n_others: int) -> Path:
    """A folder with the same cases over packs of so many other dates."""
    out = made.with_name(f"{made.name}_of_{1 + n_others}")
    if (out / "cases.csv").exists():
        return out
    out.mkdir(parents=True, exist_ok=True)
    truths, cases = (read_table(made / name) for name in ("truth.csv", "cases.csv"))
    dates = {truth["id"]: (truth["frame_date"], truth["map_date"]) for truth in truths}
    for case in cases:
        of_map, (frame_date, map_date) = Path(case["ortho"]).parent, dates[case["id"]]
        files = dates_from(of_map, first_date(of_map, frame_date, map_date), frame_date)[: 1 + n_others]
        case |= {"frame": str(made / case["frame"]), "ortho": str(pack_of(files, folder / "packs"))}
    return write_tables(out, cases, truths)


def first_date(folder: Path, frame_date: str, map_date: str) -> str:
    """The date after a frame's; the map's own where the frame is of no date of the folder."""
    names = sorted(path.stem for path in folder.glob("*.tif"))
    return names[(names.index(frame_date) + 1) % len(names)] if frame_date in names else map_date


def dates_from(folder: Path, first: str, without: str) -> list[Path]:
    """The dates of a folder from one on, those before it last, without the frame's."""
    dates = sorted(folder.glob("*.tif"))
    where = [path.stem for path in dates].index(first)
    return [path for path in dates[where:] + dates[:where] if path.stem != without]


def pack_of(files: list[Path], packs: Path) -> Path:
    """A pack of several dates, the first on top, made where it is not there yet."""
    path = packs / f"{files[0].parent.name}_{files[0].stem}_of_{len(files)}"
    if not path.exists():
        networks, why = shipped_networks()
        if why:
            raise SystemExit(why)
        path.parent.mkdir(parents=True, exist_ok=True)
        build_pack([files[0]], None, path, other_dates=files[1:], networks=networks)
    return path


if __name__ == "__main__":
    main()
