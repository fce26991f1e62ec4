"""Real imagery of two years a case: `python -m benchmarks.naip FOLDER [--jobs N] [--n N] [--limit-p P] [--photos]`.

Cases are made from the test rows (>= 400) of ../shared/data/naip; nothing of the product is fitted on them. Prints a markdown
table. `--photos` adds the drone photographs of ../shared/data/drone_urban, which are only ever scored on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from benchmarks.cases import TEST_ROWS, CaseSet, make
from benchmarks.photos import TILT_KNOWN, TILT_UNKNOWN, drone_urban
from visloc_companion.evaluate.image import evaluate_image
from visloc_companion.localise.registry import METHODS

HEADER = (
    "| cases | method | n | < 5 px | < 2 px | mean px | median px | p95 px | fix | wrong accepted | rms(e/s) N, E | "
    "altitude % | heading deg | ms |"
)


def main() -> None:
    """Make the cases, run the methods, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--n", type=int, default=200)
    parser.add_argument("--methods", nargs="*", default=list(METHODS))
    parser.add_argument("--limit-p", type=float, default=0.05, help="largest probability of being wrong; 1 takes all answers")
    parser.add_argument("--photos", action="store_true")
    args = parser.parse_args()
    half = max(1, args.n // 2)
    sets = [
        CaseSet("test_t2", "t2", args.n, TEST_ROWS, 1),
        CaseSet("test_wide", "wide", half, TEST_ROWS, 2),
        *(CaseSet(f"test_low{foot}", "low", half, TEST_ROWS, 3, foot=foot) for foot in (96, 64, 48)),
        CaseSet("test_same", "same", half, TEST_ROWS, 4),
        CaseSet("test_oblique", "oblique", half, TEST_ROWS, 5),
        CaseSet("test_elsewhere", "elsewhere", half, TEST_ROWS, 6, elsewhere="bitemporal/bragg_2009_2012"),
        CaseSet("test_blind", "blind", max(1, half // 2), TEST_ROWS, 7),
    ]
    folders = [make(case_set, args.folder) for case_set in sets]
    if args.photos:
        folders.append(drone_urban(args.folder / "photos_tilt_known", TILT_KNOWN))
        folders.append(drone_urban(args.folder / "photos_tilt_unknown", TILT_UNKNOWN))
    print(HEADER)
    print("|" + "---|" * 14)
    for folder in folders:
        for method in args.methods:
            print(
                row(
                    folder.name,
                    method,
                    evaluate_image(folder, method, args.jobs, max_probability_wrong=args.limit_p)[0]["summary"],
                ),
                flush=True,
            )


def row(name: str, method: str, s: dict[str, Any]) -> str:
    """One row of the table."""
    px = s["error_px"] or dict.fromkeys(("mean", "median", "p95"))
    sigma = s["rms_error_over_sigma"]
    cells = [
        *(name, method, s["n"], share(s["within_5px_share"]), share(s["within_2px_share"])),
        *(figure(px[k]) for k in ("mean", "median", "p95")),
        *(share(s["fix_share"]), s["wrong_and_accepted"], f"{figure(sigma['north'])}, {figure(sigma['east'])}"),
        *(figure((s[k] or {}).get("mean")) for k in ("altitude_error_percent", "heading_error_deg")),
        figure((s["elapsed_ms"] or {}).get("median"), 0),
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def figure(value: float | None, digits: int = 2) -> str:
    return "" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    main()
