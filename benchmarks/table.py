"""The table of the image localisers: `python -m benchmarks.table FOLDER [--jobs N] [--methods ...] [--n N] [--model DIR]`.

Makes the cases (`benchmarks/image_cases/sets.py`: 500 a row, 1,300 of them without a right answer), lets every method answer all
of them, and prints one row for each set and method, then the pooled figures of each method: reliability, refusals, and (with
several families of places) what each family gives. FOLDER keeps the answers, which outlive changes of verify.py: a run that was
broken off goes on where it was, `--n` takes the first so many cases of each set. `--model DIR` scores the network of that folder,
e.g. one that was trained without a place. `--breakdown` prints the errors by year gap, season, cover and texture; `--report DIR`
writes a page for each method with these, the reliability diagram and the worst cases; `--json FILE` the figures.

Accuracy is that of all answers, however doubtful; accepted are those that claim at most `--limit-p`. Far is off by more than
10 px of the map, or any answer where there is no right one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.image_cases.answers import UNSTATED, Judged, answers, code_digest, named
from benchmarks.image_cases.sets import FAMILIES, MAP_SIGMAS, NEGATIVE, PHOTOS, POSITIVE, SETS
from visloc_companion.evaluate.cases import BadCase, Case, read_cases
from visloc_companion.evaluate.images.image import MAX_PROBABILITY_WRONG, environment
from visloc_companion.evaluate.images.image_breakdown import breakdown, grounds_under
from visloc_companion.evaluate.images.image_metrics import accepted, claims, summarise
from visloc_companion.evaluate.images.image_report import write_image_report
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise.registry import METHODS

HEADER = (
    "| cases | method | n | < 15 px | < 5 px | < 2 px | mean px | median px | p95 px | accepted, right | accepted, far | "
    "refused | altitude % | heading deg | tilt deg | rms(e/s) N, E, height | in 95 % ellipse | ECE | ms |"
)


def main() -> None:
    """Make, answer, print."""
    args = _arguments()
    digest = code_digest(args.model, without_verdict=True)
    names = args.sets or list(SETS)
    folders = {name: SETS[name](args.folder / "cases") for name in names}
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    document: dict[str, Any] = {"schema": 1, "environment": environment(), "digest": digest, "limit_p": args.limit_p, "rows": []}
    for method in args.methods:
        judged = {}
        for name in names:
            sigma, store = MAP_SIGMAS.get(name, UNSTATED), args.folder / "answers"
            judged[name] = answers(folders[name], method, store, digest, args.jobs, args.n, args.model, sigma)
            cells = figures(judged[name], args.limit_p)
            document["rows"].append({"cases": name, "method": method, **cells})
            print(row(name, method, cells), flush=True)
        pooled = pooled_figures(judged, args.limit_p)
        document["rows"].append({"cases": "all", "method": method, **pooled})
        print(f"\n{method}, all: {_words(pooled)}\n", flush=True)
        if args.breakdown:
            print("\n".join(breakdown_lines(method, folders, judged, args.limit_p)), flush=True)
        if args.report:
            _report(args.report / method, method, folders, judged, args.limit_p)
    if args.json:
        args.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def figures(judged: list[Judged], limit_p: float) -> dict[str, Any]:
    """Figures of one set and method: accuracy of all answers, the rest of those accepted; `n` alone where there are no cases."""
    if not judged:
        return {"n": 0}
    truth = {r.case_id: t for r, t in judged}
    results = [r for r, _ in judged]
    everything, taken = summarise(results, truth), summarise(accepted(results, limit_p), truth)
    n = len(judged)
    return {
        "n": n,
        **{key: everything[key] for key in ("within_15px_share", "within_5px_share", "within_2px_share", "error_px")},
        "accepted_right_share": (taken["n_fix"] - taken["far_and_accepted"]) / n,
        "accepted_far": taken["far_and_accepted"],
        "refused_share": 1 - taken["n_fix"] / n,
        **{key: taken[key] for key in ("altitude_error_percent", "heading_error_deg", "tilt_error_deg", "rms_error_over_sigma")},
        "inside_95_ellipse_share": taken["inside_95_ellipse_share"],
        "expected_calibration_error": everything["reliability"]["expected_calibration_error"],
        "elapsed_ms": everything["elapsed_ms"],
    }


def pooled_figures(judged: dict[str, list[Judged]], limit_p: float) -> dict[str, Any]:
    """Figures over all sets: reliability of all claims, accepted and far among the accepted, refusals of negatives, places."""
    whole = [pair for name, pairs in judged.items() if name not in PHOTOS for pair in pairs]
    negative = [pair for name, pairs in judged.items() if name in NEGATIVE for pair in pairs]
    positive = [pair for name, pairs in judged.items() if name in POSITIVE for pair in pairs]
    good, bad, both = (figures(pairs, limit_p) for pairs in (positive, negative, whole))
    if not whole:
        return {"n": 0}
    n_accepted = round((1 - both["refused_share"]) * both["n"])
    families = {
        family: figures([pair for name in names if name in judged for pair in judged[name]], limit_p)["within_5px_share"]
        for family, names in FAMILIES.items()
        if any(name in judged for name in names)
    }
    return {
        "reliability": reliability(*claims(whole)),
        "solvable_accepted_share": good.get("accepted_right_share"),
        "far_of_accepted_share": both["accepted_far"] / n_accepted if n_accepted else None,
        "accepted": n_accepted,
        "negatives": bad["n"],
        "negatives_refused_share": bad.get("refused_share"),
        "inside_95_ellipse_share": both["inside_95_ellipse_share"],
        "within_5px_share_by_place": families,
    }


def breakdown_lines(method: str, folders: dict[str, Path], judged: dict[str, list[Judged]], limit_p: float) -> list[str]:
    """Markdown of what the errors over NAIP depend on, all of its sets together."""
    names = [name for name in FAMILIES["naip"] if name in judged]
    pairs = [pair for name in names for pair in judged[name]]
    cases = {case.case_id: case for name in names for case in _cases(folders[name])}
    lines = [f"| {method} over NAIP, by | | n | < 5 px | < 2 px | mean px | accepted | of these far |", f"|{'---|' * 8}"]
    for g in breakdown(pairs, grounds_under(pairs, cases), limit_p):
        cells = (g.group, g.label, g.n, share(g.within_5px), share(g.within_2px), figure(g.error_px), g.accepted, g.far)
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return [*lines, ""]


def row(name: str, method: str, s: dict[str, Any]) -> str:
    """One row of the table."""
    px = s["error_px"] or dict.fromkeys(("mean", "median", "p95"))
    sigma = s["rms_error_over_sigma"]
    cells = [
        *(name, method, s["n"], *(share(s[f"within_{limit}px_share"]) for limit in (15, 5, 2))),
        *(figure(px[k]) for k in ("mean", "median", "p95")),
        *(share(s["accepted_right_share"]), s["accepted_far"], share(s["refused_share"])),
        figure((s["altitude_error_percent"] or {}).get("mean")),
        *(figure((s[f"{angle}_error_deg"] or {}).get("median")) for angle in ("heading", "tilt")),
        ", ".join(figure(sigma[axis]) for axis in ("north", "east", "height")).strip(", "),
        *(share(s["inside_95_ellipse_share"]), figure(s["expected_calibration_error"], 3)),
        figure((s["elapsed_ms"] or {}).get("median"), 0),
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def figure(value: float | None, digits: int = 2) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_words(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _report(folder: Path, method: str, folders: dict[str, Path], judged: dict[str, list[Judged]], limit_p: float) -> None:
    results = [r for pairs in judged.values() for r, _ in pairs]
    truth = {r.case_id: t for pairs in judged.values() for r, t in pairs}
    cases = [case for name in judged for case in _cases(folders[name])]
    taken = accepted(results, limit_p)
    document = {"schema": 1, "method": method, "environment": environment(), "summary": summarise(taken, truth)}
    print(write_image_report(folder, document, results, truth, cases=cases, max_probability_wrong=limit_p), flush=True)


def _cases(folder: Path) -> list[Case | BadCase]:
    return [named(case, folder) for case in read_cases(folder)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--n", type=int, help="the first so many cases of each set")
    parser.add_argument("--methods", nargs="*", default=[method for method in METHODS if method != "cross-view"])
    parser.add_argument("--sets", nargs="*", choices=list(SETS))
    parser.add_argument("--limit-p", type=float, default=MAX_PROBABILITY_WRONG, help="largest probability of being wrong")
    parser.add_argument("--model", type=Path, help="folder of the network to score, instead of the shipped one")
    parser.add_argument("--breakdown", action="store_true", help="print what the errors over NAIP depend on")
    parser.add_argument("--report", type=Path, help="folder for the pages")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
