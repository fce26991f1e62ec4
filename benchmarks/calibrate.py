"""Fit what the localisers claim, on training data only: `python -m benchmarks.calibrate FOLDER [--method NAME] [--n N]`.

Data: four families of places. NAIP rows above 400 with frames of water, cloud, other places and ground outside the map; the
bi-temporal pairs, and NAIP frames looked for on them; the procedural landscape's seeds below 100 at 0.3 to 1 m a pixel. NAIP and
the landscape also with a tilt that the prior does not know, the landscape with and without its surface model; and cameras that
lean over its woods. Two more are judged and not fitted to: the landscape laid out alike in several places, and lines that have
moved since the map was made. `deep` is fitted thrice: its first look at every frame, the quarters of those that it declines (by
the coefficients of verify.py), and its second look, which is judged on what is still declined. What is fitted is what flies: the
logistic function times what other places and single blocks, or the quarters, leave a match.

Prints the logistic coefficients (localise/verify.py for the dense methods), how honest they are when fitted without a family and
judged on it, and the ratio of errors to claimed sigmas. FOLDER keeps the evidence of every case; it outlives changes of
verify.py, so a refit takes seconds. `--model DIR` fits for the network of that folder.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.image_cases.answers import RENDERED, UNSTATED, WEIGHTS, Judged, answers, code_digest, judged_anew
from benchmarks.image_cases.training_sets import FAMILIES, MADE, SETS
from visloc_companion.evaluate.images.image_metrics import CaseError, CaseResult, case_error
from visloc_companion.evaluate.protection import CHI2_95
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise import iclk, mutual_information
from visloc_companion.localise.dense import LOOK_AGAIN_ABOVE
from visloc_companion.localise.settings import Looks
from visloc_companion.localise.verify import (
    DEEP_WEIGHTS,
    Evidence,
    fewer_places,
    left_to_place,
    near_enough,
    probability_of_place,
    quarter_regressors,
)

LIMITS = (0.1, 0.05, 0.03, 0.01, 0.003)
RIDGE, LEAST, SIGNS = 1.0, 0.2, (0, 1, 0, 1, 1, 0, -1, -1, 1, 0, 1, 1, 1)
"""Of the fits to `Evidence.regressors`, for places that are not among these: how strong a ridge, and what counts for a match or
against it, by at least so many nats for the scatter of each. Each family of `deep` judged by what is fitted without it,
log-likelihoods are -549 at the first look and -266 at the second; -558 and -268 without signs, -546 and -255 with a ridge of 3,
which accepts fewer."""
JUDGED_ONLY = ("alike", "moved")
"""Families that nothing is fitted to: on such ground they judge what multiplies the logistic function. Shares as regressors that
are fitted to one of them do not hold on the other."""
QUARTER_SIGNS = (0, 1, 1)
PRECISELY = {"maxiter": 2000, "ftol": 1e-12, "gtol": 1e-7}
Array = NDArray[np.float64]
Signs = tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Regressors (N, K), whether right (N,) and family (N,) of every answer; `near` are errors that are no wrong matches.

    `sure` (N,) is the probability that the right place is near enough by its claimed sigma, times the shares that other places
    and the blocks on their own leave it (what multiplies the logistic function in flight), 1 for methods that do without these,
    `fewer` (N,) the nats by which fewer places were searched than the weights are for, 0 for such methods; `signs` those that the
    weights may have.
    """

    x: Array
    right: Array
    sure: Array
    fewer: Array
    family: NDArray[np.str_]
    signs: Signs | None
    near: dict[str, list[CaseError]]


def main() -> None:
    """Make the cases, localise them with every answer accepted, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--method", default="gradient")
    parser.add_argument("--n", type=int, help="the first so many cases of each set")
    parser.add_argument("--whole", nargs="*", choices=list(SETS), default=[], help="sets that are taken whole all the same")
    parser.add_argument("--sets", nargs="*", choices=list(SETS), default=list(SETS))
    parser.add_argument("--model", type=Path, help="folder of the network, instead of the shipped one")
    args = parser.parse_args()
    digest = code_digest(args.model, without_verdict=True)
    folders = {name: SETS[name](args.folder / "cases") for name in args.sets}

    def judged_by(looks: Looks) -> dict[str, list[Judged]]:
        judged: dict[str, list[Judged]] = {}
        for name, folder in folders.items():
            sigma, store = RENDERED if name in MADE else UNSTATED, args.folder / "answers"
            n = None if name in args.whole else args.n
            judged[name] = answers(folder, args.method, store, digest, args.jobs, n, args.model, sigma, looks)
            print(_set_line(name, judged[name]), flush=True)
        return judged

    first = judged_by(Looks.FIRST)
    samples = collect(args.method, first)
    _fitted(samples, samples)
    if args.method == "deep":
        print("\nThe first look at what it declines, its quarters asked")
        asked = collect_asked(first)
        if len(asked.x):
            _fitted(asked, asked)
        print("\nThe second look, judged on what the first one declines")
        taken = {r.case_id for pairs in first.values() for r, _ in pairs if _convincing(r)}
        second = {name: [j for j in pairs if _another(j)] for name, pairs in judged_by(Looks.SECOND).items()}
        declined = {name: [j for j in pairs if j[0].case_id not in taken] for name, pairs in second.items()}
        _fitted(collect(args.method, second), collect(args.method, declined))


def _convincing(result: CaseResult) -> bool:
    """As `looks.convincing` has it of the first look of `deep`."""
    evidence = {name: value for name, value in result.evidence.items() if name != "prior_px"}
    unaided = judged_anew(replace(result, evidence=evidence), "deep").fix
    return unaided is not None and unaided.probability_wrong <= LOOK_AGAIN_ABOVE


def _another(judged: Judged) -> bool:
    """Whether the second look is another one: where the map has nothing finer than what is searched, both are the same."""
    return judged[0].evidence.get("looks") == 2.0


def _fitted(samples: Samples, judged: Samples) -> None:
    """Fit, print, and judge: all that is fitted to, and each family by what is fitted without it."""
    fitted, of_fitted = (~np.isin(each.family, JUDGED_ONLY) for each in (samples, judged))
    weights = _fit(samples, fitted)
    print("\nweights", tuple(float(f"{w:.3g}") for w in weights))
    print(_honesty("fitted and judged on all", _claims(judged, weights)[of_fitted], judged.right[of_fitted]))
    for family in sorted(set(judged.family)):
        others, here = fitted & (samples.family != family), judged.family == family
        if 0 < samples.right[others].sum() < others.sum():
            p = _claims(judged, _fit(samples, others))[here]
            print(_honesty(f"fitted without {family}, judged on it", p, judged.right[here]))
    for family, errors in judged.near.items():
        print(_covariance_line(family, errors))


def _fit(samples: Samples, which: NDArray[np.bool_]) -> Array:
    chosen = samples.x[which], samples.right[which], samples.sure[which], samples.fewer[which]
    return fit_logistic(*chosen) if samples.signs is None else fit_logistic(*chosen, RIDGE, samples.signs)


def _claims(samples: Samples, weights: Array) -> Array:
    return probability_wrong(samples.x, weights, samples.sure, samples.fewer)


def collect(method: str, judged: dict[str, list[Judged]]) -> Samples:
    """What the fit is on, from the answers of all sets. A refusal that holds whatever is claimed is no sample, nor is an answer
    that is between wrong and far and lies within its claimed ellipse: that place is right."""
    x, right, sure, fewer, family = [], [], [], [], []
    near: dict[str, list[CaseError]] = {}
    for name, pairs in judged.items():
        place = next(f for f, names in FAMILIES.items() if name in names)
        for result, truth in pairs:
            error = case_error(result, truth)
            if not _is_sample(error):
                continue
            x.append(regressors(method, result))
            evidence = Evidence.from_numbers(result.evidence) if method in WEIGHTS else None
            numbers = result.evidence
            sure.append(1.0 if evidence is None else near_enough(evidence) * numbers["share"] * numbers["votes"])
            fewer.append(0.0 if evidence is None else fewer_places(evidence.prior_px))
            right.append(not error.wrong)
            family.append(place)
            if not error.wrong:
                near.setdefault(place, []).append(error)
    table, truths, factors, nats = (np.array(values, dtype=np.float64) for values in (x, right, sure, fewer))
    signs = SIGNS if method in WEIGHTS else None
    return Samples(table, truths, factors, nats, np.array(family), signs, near)


def collect_asked(judged: dict[str, list[Judged]]) -> Samples:
    """What the fit of the quarters is on: the first looks of `deep` that asked them, by the coefficients of verify.py."""
    asked = {name: [(r, t) for r, t in pairs if "quarters" in r.evidence] for name, pairs in judged.items()}
    of_looks = collect("deep", asked)
    x, sure = [], []
    for result, truth in (pair for pairs in asked.values() for pair in pairs):
        if _is_sample(case_error(result, truth)):
            numbers, evidence = result.evidence, Evidence.from_numbers(result.evidence)
            place = probability_of_place(evidence, DEEP_WEIGHTS)
            x.append(quarter_regressors(place, numbers["quarters"]))
            sure.append(near_enough(evidence) * left_to_place(numbers))
    return replace(of_looks, x=np.array(x), sure=np.array(sure), fewer=np.zeros(len(x)), signs=QUARTER_SIGNS)


def _is_sample(error: CaseError | None) -> TypeGuard[CaseError]:
    return error is not None and not (error.wrong and not error.far and error.chi2 <= CHI2_95)


def regressors(method: str, result: CaseResult) -> tuple[float, ...]:
    """What the logistic regression of a method is on."""
    e = result.evidence
    if method in WEIGHTS:
        return Evidence.from_numbers(e).regressors()
    if method == "iclk":
        return iclk.regressors(e)
    if method == "mi":
        return mutual_information.regressors(e)
    return (1.0, e["inliers"]) if method == "keypoint" else (1.0, e["score"], 1 - e["runner_up"])


def probability_wrong(x: Array, weights: Array, sure: Array | float = 1.0, known: Array | float = 0.0) -> Array:
    """(N,) of regressors (N, K), of the probability (N,) that the right place is near enough, and of nats (N,) that are known."""
    return np.asarray(1 - sure / (1 + np.exp(-np.clip(x @ weights + known, -50, 50))), dtype=np.float64)


def fit_logistic(
    x: Array, y: Array, sure: Array | float = 1.0, known: Array | float = 0.0, ridge: float = 0.3, signs: Signs | None = None
) -> Array:
    """Weights of a logistic regression with a slight ridge on all but the constant; of a sign and not 0, where `signs` says one.

    y (N,) is 1 with the probability sure (N,) times the logistic function of x (N, K) and the weights, and nats known (N,).
    """
    scale = np.append(1.0, np.maximum(x[:, 1:].std(0), 1e-9))
    sure = np.minimum(sure, 1 - 1e-12)
    x, penalty = x / scale, np.append(0.0, np.full(x.shape[1] - 1, ridge))

    def cost(weights: Array) -> tuple[float, Array]:
        p = 1 / (1 + np.exp(-np.clip(x @ weights + known, -30, 30)))
        right = sure * p
        nats = np.where(y > 0.5, np.log(np.maximum(right, 1e-300)), np.log1p(-right))
        slope = (1 - p) / (1 - right)  # of the log-odds of y over those of the place
        return float(penalty @ weights**2 / 2 - nats.sum()), penalty * weights - x.T @ ((y - right) * slope)

    bounds = [(LEAST if sign > 0 else None, -LEAST if sign < 0 else None) for sign in signs or (0,) * x.shape[1]]
    found = minimize(cost, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds, options=PRECISELY)
    return np.asarray(found.x / scale)


def _set_line(name: str, judged: list[Judged]) -> str:
    errors = [e for r, t in judged if (e := case_error(r, t)) is not None]
    right = [e.horizontal_px for e in errors if not e.wrong]
    mean = f", mean of these {np.mean(right):.3f} px" if right else ""
    return f"{name}: {len(judged)} cases, {len(errors)} answers, {len(right)} right{mean}"


def _honesty(what: str, p: Array, right: Array) -> str:
    figures = reliability(p, right < 0.5)
    separation = figures["separation"]
    lines = [
        f"{what}: {figures['n']} answers, {figures['n_wrong']} wrong, claimed {figures['claimed_wrong']:.1f}, ECE "
        f"{figures['expected_calibration_error']:.4f}, excess {figures['excess_sigmas']:+.1f} sigma"
        + ("" if separation is None else f", AUC {separation:.4f}")
    ]
    for limit in LIMITS:
        taken = p <= limit
        kept = 100 * right[taken].sum() / max(right.sum(), 1.0)
        lines.append(
            f"  p <= {limit}: {int(taken.sum())} accepted, {int((1 - right)[taken].sum())} wrong, {kept:.1f} % of the right"
        )
    return "\n".join(lines)


def _covariance_line(family: str, errors: list[CaseError]) -> str:
    whitened = np.array([e.sigmas for e in errors])
    inside = np.mean([e.chi2 <= CHI2_95 for e in errors])
    rms, robust = np.sqrt((whitened**2).mean(0)), np.percentile(np.abs(whitened), 68.3, axis=0)
    return (
        f"{family}: rms(error / sigma) north, east, height {rms.round(2)}, 68 % of |error / sigma| below {robust.round(2)}, "
        f"{100 * inside:.1f} % inside the 95 % ellipse ({len(errors)} right answers)"
    )


if __name__ == "__main__":
    main()
