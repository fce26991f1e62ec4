"""The table of cloud registration: `python -m benchmarks.clouds CLOUDS WORK [--n N] [--methods ...] [--levels ...] [--foreign]`.

Makes N cases for each cloud of CLOUDS, scenario and level (and of made clouds without information) in WORK, lets every method
answer all of them, and prints a row for each method, level, scenario and land cover, then the pooled figures. Rows marked `*` are
of places that the claims were fitted on (other cases of them: another seed).

A case is on the reference where half of its source is: the rest shows, say, a river where the reference has a few stray returns.
Right is within 5 m horizontally; accepted is what claims to be wrong with at most `--limit-p`. "< 5 m" and the horizontal median
are of all cases, a refusal counting as infinitely far; MTRE, sigmas and ellipse are of what is accepted.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cloud_sets.bare_clouds import write_bare_clouds
from benchmarks.cloud_sets.cloud_answers import FAR_M, WRONG_M, CloudAnswer, answer_of
from benchmarks.cloud_sets.cloud_cases import BLANK, FITTED, LEVELS, CloudCase, foreign, make, read
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise.registration.registry import DEFAULT_MAX_PROBABILITY_WRONG, METHODS, make_registration

SEED = 1
HALF = 0.5
HEADER = (
    "| method | level | scenario | place | n | accepted % | accepted, wrong | accepted, far | < 5 m % | horizontal median m | "
    "accepted: MTRE median m | < 5 m % | rms(e/s) E, N, up | in 95 % | CPU s |"
)


def all_cases(
    clouds: Path, work: Path, n: int, seed: int, only: tuple[str, ...] | None, levels: Sequence[str] = LEVELS, *, on_foreign: bool
) -> Iterator[CloudCase]:
    """Of these levels, one at a time; `on_foreign`: each source also on another cloud's reference."""
    bare = write_bare_clouds(work / "bare", seed)
    for level in levels:
        folder = make(clouds, work / "real", level, n, seed)
        yield from read(folder, level, only)
        if on_foreign:
            yield from foreign(list(read(folder, level, only)))
        yield from read(make(bare, work / "bare_cases", level, max(1, n // 4), seed), level, only)


def main() -> None:
    """Make, answer, print."""
    args = _arguments()
    only = tuple(args.clouds_only) if args.clouds_only else None
    rows: list[dict[str, Any]] = []
    print(f"{HEADER}\n|{'---|' * HEADER.count(' | ')}---|", flush=True)
    for name in args.methods:
        method = make_registration(name, 1.0)
        cases = all_cases(args.clouds, args.work, args.n, args.seed, only, args.levels, on_foreign=args.foreign)
        most = args.first.get(name, args.n)
        found = [answer_of(method, case) for case in cases if number(case) < most]
        for label, some in groups(found):
            rows.append({"method": name, **label, **figures(some, args.limit_p)})
            print(_row(rows[-1]), flush=True)
        scored = [a for a in found if a.cloud not in FITTED]
        for what, some in (("all places", found), ("places not fitted on", scored)):
            print(f"\n{name}, {what}: {pooled(some, args.limit_p)}\n", flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def groups(found: list[CloudAnswer]) -> Iterator[tuple[dict[str, str], list[CloudAnswer]]]:
    """By level, scenario and cloud; then all with information, of them those on the reference and those not fitted on."""
    whole: list[tuple[str, Callable[[CloudAnswer], bool]]] = [
        ("all with information", lambda a: a.cover not in BLANK),
        ("of these on the reference", lambda a: a.cover not in BLANK and a.covered >= HALF),
        ("of these not fitted on", lambda a: a.cover not in BLANK and a.cloud not in FITTED),
    ]
    for level in LEVELS:
        for scenario in "AB":
            some = [a for a in found if (a.level, a.scenario) == (level, scenario)]
            for cover, cloud in sorted({(a.cover, a.cloud) for a in some}):
                place = f"{cover}: {cloud}{'*' if cloud in FITTED else ''}"
                yield _label(level, scenario, place), [a for a in some if a.cloud == cloud]
            for place, belongs in whole:
                if chosen := [a for a in some if belongs(a)]:
                    yield _label(level, scenario, place), chosen


def number(case: CloudCase) -> int:
    """Of a case among those of its cloud, scenario and level, from 0."""
    return int(case.name.rsplit("_", 1)[1])


def figures(some: list[CloudAnswer], limit_p: float) -> dict[str, Any]:
    """Figures of one row; None where nothing was accepted, or a median is of a refusal."""
    taken = [a for a in some if a.probability_wrong <= limit_p]
    horizontal = np.array([a.horizontal_m for a in some])
    near = [a for a in taken if not a.wrong]
    z = np.array([a.error_m / np.sqrt(np.diag(a.covariance_m2)) for a in near])
    return {
        "n": len(some),
        "accepted_share": len(taken) / len(some),
        "accepted_wrong": sum(a.wrong for a in taken),
        "accepted_far": sum(a.horizontal_m > FAR_M for a in taken),
        "within_5m_share": float((horizontal < WRONG_M).mean()),
        "horizontal_median_m": _finite(float(np.median(horizontal))),
        "mtre_median_m": _finite(float(np.median([a.mtre_m for a in taken]))) if taken else None,
        "mtre_within_5m_share": float(np.mean([a.mtre_m < WRONG_M for a in taken])) if taken else None,
        "rms_error_over_sigma": [round(float(v), 3) for v in np.sqrt((z**2).mean(0))] if near else None,
        "inside_95_ellipse_share": float(np.mean([a.inside for a in near])) if near else None,
        "cpu_s": float(np.median([a.cpu_s for a in some])),
    }


def pooled(some: list[CloudAnswer], limit_p: float) -> str:
    """How honest `probability_wrong` is, over all answers."""
    answered = [a for a in some if not a.reason]
    if not answered:
        return f"{len(some)} cases, no answers"
    p, wrong = np.array([a.probability_wrong for a in answered]), np.array([a.wrong for a in answered])
    honest = reliability(p, wrong)
    far = sum(a.horizontal_m > FAR_M for a in answered if a.probability_wrong <= limit_p)
    taken, share = int((p <= limit_p).sum()), 100 * far / len(some)
    return (
        f"{len(some)} cases, {len(answered)} answers, {int(wrong.sum())} wrong, claimed {p.sum():.1f}; "
        f"AUC {honest['separation']}, ECE {honest['expected_calibration_error']:.4f}; "
        f"accepted {taken}, of these {far} far ({share:.2f} % of all cases)"
    )


def _label(level: str, scenario: str, place: str) -> dict[str, str]:
    return {"level": level, "scenario": scenario, "place": place}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _row(f: dict[str, Any]) -> str:
    rms = "–" if f["rms_error_over_sigma"] is None else ", ".join(f"{v:.2f}" for v in f["rms_error_over_sigma"])
    cells = [f["method"], f["level"], f["scenario"], f["place"], str(f["n"]), _percent(f["accepted_share"])]
    cells += [str(f["accepted_wrong"]), str(f["accepted_far"]), _percent(f["within_5m_share"])]
    cells += [_metres(f["horizontal_median_m"]), _metres(f["mtre_median_m"]), _percent(f["mtre_within_5m_share"])]
    cells += [rms, _percent(f["inside_95_ellipse_share"]), f"{f['cpu_s']:.2f}"]
    return f"| {' | '.join(cells)} |"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f}"


def _metres(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", type=Path, help="folder of .laz files, as the shared tool takes it")
    parser.add_argument("work", type=Path, help="where the cases are kept")
    parser.add_argument("--n", type=int, default=20, help="cases a cloud, scenario and level")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--first", nargs="+", type=_first, default=[], metavar="METHOD=K", help="slow methods: the first K only")
    parser.add_argument("--clouds-only", nargs="+", help="names of the clouds to take")
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=LEVELS, help="how much the sources are degraded")
    parser.add_argument(
        "--foreign", action="store_true", help="also each source on another cloud's reference, where all are wrong"
    )
    parser.add_argument("--limit-p", type=float, default=DEFAULT_MAX_PROBABILITY_WRONG)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    args.first = dict(args.first)
    return args


def _first(text: str) -> tuple[str, int]:
    method, _, most = text.partition("=")
    if method not in METHODS or not most.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}: give METHOD=K, METHOD one of {', '.join(METHODS)}")
    return method, int(most)


if __name__ == "__main__":
    main()
