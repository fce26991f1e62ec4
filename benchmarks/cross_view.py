"""Frames of unknown heading and lean (task T1): `python -m benchmarks.cross_view FOLDER [--n N] [--jobs N] [--fit]`.

Prints for each set how far all answers are off, whatever they claim, as a share of what guessing the prior's middle costs; how
many are accepted at 0.05; and how far the mean of the nine likeliest candidates of the search is off, weighted by how much they
stand out and not. `--fit` fits the claims on training rows instead and prints the weights. FOLDER keeps cases and answers.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.calibrate import fit_logistic
from benchmarks.image_cases.answers import Judged, answers, code_digest
from benchmarks.image_cases.cross_view_cases import FIT, SETS
from visloc_companion.evaluate.cases import BadCase, read_cases
from visloc_companion.evaluate.images.image_metrics import CaseError, CaseResult, case_error
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.evaluate.reliability import excess_sigmas
from visloc_companion.geo.wgs84 import ned_from_geo
from visloc_companion.localise.cross_view import REPORTED
from visloc_companion.localise.verify import unknown_attitude_regressors
from visloc_companion.types import FloatArray, GeoPoint

METHOD, LIMIT = "cross-view", 0.05
WEIGHT_NATS = 2.0
"""Of a candidate's weight in the mean for every standard deviation by which it stands out."""
DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Scored:
    """One case: what was answered, its error (None without an answer), and metres north, east of the truth from the prior."""

    result: CaseResult
    error: CaseError | None
    truth_ne_m: FloatArray


def main() -> None:
    """Make the cases, localise them, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n", type=int, default=44)
    parser.add_argument("--elsewhere", type=int, default=20, help="frames of other places with --fit")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--fit", action="store_true")
    args = parser.parse_args()
    digest = code_digest(None, without_verdict=True)
    made = FIT if args.fit else {name: SETS[name] for name in args.sets}
    everything: list[Scored] = []
    for name, make in made.items():
        n = args.elsewhere if name == "t1_fit_elsewhere" else args.n
        folder = make(args.folder, n)
        scored = with_errors(folder, answers(folder, METHOD, args.folder, digest, args.jobs, n))
        print(f"{name}: {summary(scored)}", flush=True)
        everything += scored
    if args.fit:
        print("weights", tuple(float(f"{w:.3g}") for w in fitted(everything)))


def with_errors(folder: Path, judged: list[Judged]) -> list[Scored]:
    """Answers with their errors and with where the truth lies of the prior."""
    scored = []
    for case, (result, truth) in zip(read_cases(folder), judged, strict=False):
        if isinstance(case, BadCase):
            raise SystemExit(f"{folder}: {case.case_id} {case.why}")
        at = ned_from_geo(GeoPoint(truth.lat_deg, truth.lon_deg, 0.0), case.prior.place)[:2]
        scored.append(Scored(result, case_error(result, truth), np.array(at)))
    return scored


def fitted(scored: list[Scored]) -> FloatArray:
    """Weights of being right. An answer that is off by less than its ellipse of 95 % says is no sample of being wrong."""
    pairs = [(each.result, each.error) for each in scored if each.error and not _undecided(each.error)]
    table = np.array([unknown_attitude_regressors(result.evidence) for result, _ in pairs])
    return fit_logistic(table, np.array([float(not error.wrong) for _, error in pairs]))


def summary(scored: list[Scored]) -> str:
    """How far off, in words."""
    answered = [(each.result, each.error) for each in scored if each.error]
    errors = [error for _, error in answered]
    off_m, wrong = np.array([e.horizontal_m for e in errors]), np.array([e.wrong for e in errors])
    p = np.array([result.fix.probability_wrong for result, _ in answered if result.fix])
    taken = p <= LIMIT
    beyond = np.array([e.chi2 > CHI2_95 for e in errors])
    guess_m = float(np.mean([np.linalg.norm(each.truth_ne_m) for each in scored]))
    chosen = [error for error, is_taken in zip(errors, taken, strict=True) if is_taken]
    within = 100 * (1 - wrong.mean())
    lines = [
        f"{len(answered)} of {len(scored)} answered; guessing the middle of the prior {guess_m:.0f} m off",
        f"all answers: {_off(off_m)} ({100 * off_m.mean() / guess_m:.1f} % of guessing), {within:.0f} % within 5 px, "
        f"height off {_height(errors)}; {excess_sigmas(p, wrong):+.1f} sigma more wrong than claimed",
        f"accepted at {LIMIT}: {taken.sum()}, of which {wrong[taken].sum()} wrong; {_off(off_m[taken])}, "
        f"height off {_height(chosen)}, {beyond[taken].sum()} beyond 95 % of the claim",
        patches(scored),
        f"{np.median([each.result.elapsed_ms for each in scored]) / 1e3:.0f} s each (median)",
    ]
    return "\n  ".join(lines)


def patches(scored: list[Scored]) -> str:
    """How far the mean of the likeliest candidates is off, weighted and not, and whether the difference is more than chance."""
    weighted, plain = (np.array([_mean_off_m(each, nats) for each in scored]) for nats in (WEIGHT_NATS, 0.0))
    gain = plain - weighted
    drawn = np.random.default_rng(1).choice(gain, (DRAWS, len(gain))).mean(1)
    low, high = np.percentile(drawn, (2.5, 97.5))
    means = f"mean of {REPORTED} candidates: weighted {weighted.mean():.0f} m, plain {plain.mean():.0f} m"
    return f"{means}; weighting gains {gain.mean():.0f} m ({low:.0f} to {high:.0f}, 95 % by bootstrap)"


def _mean_off_m(each: Scored, nats: float) -> float:
    evidence = each.result.evidence
    ranks = [k for k in range(1, REPORTED + 1) if f"patch{k}_north_m" in evidence]
    if not ranks:
        return float(np.linalg.norm(each.truth_ne_m))
    at = np.array([(evidence[f"patch{k}_north_m"], evidence[f"patch{k}_east_m"]) for k in ranks])
    out = np.array([evidence[f"patch{k}_stands_out"] for k in ranks])
    weight = np.exp(nats * (out - out.max()))
    return float(np.linalg.norm(weight @ at / weight.sum() - each.truth_ne_m))


def _off(off_m: FloatArray) -> str:
    return f"mean {off_m.mean():.1f}, median {np.median(off_m):.1f} m" if len(off_m) else "none"


def _height(errors: list[CaseError]) -> str:
    percent = np.abs([e.h_percent for e in errors])
    return f"mean {percent.mean():.1f} %, median {np.median(percent):.1f} %" if len(percent) else "-"


def _undecided(error: CaseError) -> bool:
    return error.wrong and not error.far and error.chi2 <= CHI2_95


if __name__ == "__main__":
    main()
