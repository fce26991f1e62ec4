"""Fit what registration claims: `python -m benchmarks.calibrate_clouds CLOUDS WORK [--n N] [--seeds ...] [--hold K]`.

Answers are kept in WORK/answers, a file for the clouds and one for each world: what is there is taken up again.

On four places of CLOUDS (`benchmarks.cloud_sets.cloud_cases.FITTED`), both levels; the same with a thinned reference; sources on
the reference of another of these places, where there is no right answer; made clouds without information
(`benchmarks/cloud_sets/bare_clouds.py`); and the procedural landscape (`benchmarks/cloud_sets/cloud_landscape.py`), also on other
ground. Prints the logistic weights of `probability_wrong`, what they say of each place and world when fitted on the others, and
the ratio of errors to claimed sigmas.
"""

from __future__ import annotations

import argparse
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.cloud_sets.bare_clouds import write_bare_clouds
from benchmarks.cloud_sets.cloud_answers import CloudAnswer, answers
from benchmarks.cloud_sets.cloud_cases import FITTED, LEVELS, SPARSE, CloudCase, elsewhere, make, read, thinned
from benchmarks.cloud_sets.cloud_landscape import TRAINING, TRAINING_ELSEWHERE, training_cases
from benchmarks.cloud_sets.kept_answers import kept
from visloc_companion.evaluate.reliability import reliability
from visloc_companion.localise.registration.base import RegistrationMethod
from visloc_companion.localise.registration.claims import WEIGHTS, at_least, regressors
from visloc_companion.localise.registration.evidence import Evidence
from visloc_companion.localise.registration.registry import METHODS, make_registration

Array = NDArray[np.float64]
Weights = tuple[float, ...]
SEED = 71
RIDGE = 0.03
SEEDS = (21, 22, 23, 24, 25, 26, 27, 28)
PLACES = ("buildings", "mixed", "field", "forest", "gullies", "other")
"""Covers that tell one place from another (the landscape's is other): elsewhere an answer is wrong even where chance brought it
near."""


def fit_cases(clouds: Path, work: Path, n: int) -> list[CloudCase]:
    """Of every kind; sources on another place's reference are as many as right ones at one level."""
    cases: list[CloudCase] = []
    bare = write_bare_clouds(work / "bare", SEED)
    for level in LEVELS:
        real = list(read(make(clouds, work / "real", level, n, SEED), level, FITTED))
        cases += real + [thinned(c, SPARSE, k) for k, c in enumerate(real) if k % 2]
        cases += list(read(make(bare, work / "bare_cases", level, n, SEED), level))
        for k, case in enumerate(real):
            others = [c for c in real if c.cloud != case.cloud and c.scenario == case.scenario]
            cases += [elsewhere(case, others[k % len(others)])] if k % 2 else []
    return cases


def main() -> None:
    """Make the cases, register them with every answer accepted, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clouds", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--method", choices=list(METHODS), default="height-search")
    parser.add_argument("--n", type=int, default=10, help="cases a cloud, scenario and level")
    parser.add_argument("--seeds", type=int, nargs="*", default=SEEDS, help="of the landscape")
    parser.add_argument("--hold", type=int, default=0, help="so many of the weights that ship stay as they are")
    errors_m, places = zip(*TRAINING, strict=True)
    parser.add_argument("--places", type=int, nargs=4, default=places, help=f"of a landscape, the prior off by {errors_m} m")
    parser.add_argument("--elsewhere", type=int, default=TRAINING_ELSEWHERE, help="sources on the ground of the seed before")
    args = parser.parse_args()
    found = [a for a in collected(args) if not a.reason]
    evidence = [Evidence(**a.evidence) for a in found]
    x = np.array([regressors(e) for e in evidence])
    right = np.array([not a.wrong and a.cover in PLACES for a in found], dtype=np.float64)
    held = WEIGHTS[: args.hold]
    weights, p = fitted(x, right, held), crossed(x, right, np.array([a.cloud for a in found]), held)
    p = np.array([at_least(q, e) for q, e in zip(p, evidence, strict=True)])
    figures = reliability(p, right < 0.5)
    print(
        f"{args.method}: {len(found)} answers, {int((1 - right).sum())} wrong, claimed {p.sum():.1f}, AUC {figures['separation']}"
    )
    print("WEIGHTS", ", ".join(f"{w:.3g}" for w in weights))
    for limit in (0.01, 0.02, 0.05, 0.1):
        taken = p <= limit
        print(
            f"  p <= {limit}: {100 * right[taken].sum() / right.sum():.1f} % of the right, {int((1 - right)[taken].sum())} wrong"
        )
    for line in sigma_lines([a for a, r in zip(found, right, strict=True) if r]):
        print(line)


def collected(args: argparse.Namespace) -> list[CloudAnswer]:
    """Of the clouds and of each world, every answer accepted."""
    folder, method = args.work / "answers", make_registration(args.method, 1.0)
    of_clouds = f"{args.method}_clouds_{SEED}_{args.n}"
    found = kept(folder, of_clouds, lambda: answers(method, fit_cases(args.clouds, args.work, args.n))) if args.n else []
    size = "_".join(str(k) for k in (*args.places, args.elsewhere))
    for before, seed in zip((None, *args.seeds), args.seeds, strict=False):
        of_world = partial(_answers_of_world, method, seed, before, args)
        found += kept(folder, f"{args.method}_landscape_{seed}_after_{before}_{size}", of_world)
        print(f"{len(found)} answers", flush=True)
    return found


def _answers_of_world(method: RegistrationMethod, seed: int, before: int | None, args: argparse.Namespace) -> list[CloudAnswer]:
    places = [(error_m, n) for (error_m, _), n in zip(TRAINING, args.places, strict=True)]
    return answers(method, training_cases(seed, before, places, args.elsewhere))


def fitted(x: Array, right: Array, held: Weights = ()) -> Array:
    """Weights of a logistic regression with a ridge on what is standardised: the first for the constant, or all of those beside
    the first ones, which are `held`."""
    if held:
        free, known = x[:, len(held) :], x[:, : len(held)] @ np.array(held)
        scale = np.maximum(free.std(0), 1e-9)
        return np.append(held, _logistic(free / scale, right, known, RIDGE) / scale)
    mean, scale = x[:, 1:].mean(0), np.maximum(x[:, 1:].std(0), 1e-9)
    z = np.column_stack([np.ones(len(x)), (x[:, 1:] - mean) / scale])
    w = _logistic(z, right, np.zeros(len(x)), np.append(0.0, np.full(len(scale), RIDGE)))
    return np.append(w[0] - w[1:] / scale @ mean, w[1:] / scale)


def _logistic(z: Array, right: Array, known: Array, ridge: float | Array) -> Array:
    """Weights of z, beside log-odds that are known."""

    def cost(w: Array) -> tuple[float, Array]:
        odds = known + z @ w
        held = ridge * w
        value = float(np.sum(np.logaddexp(0, odds) - right * odds) + 0.5 * held @ w)
        return value, z.T @ (expit(odds) - right) + held

    return np.asarray(minimize(cost, np.zeros(z.shape[1]), jac=True, method="L-BFGS-B").x)


def crossed(x: Array, right: Array, group: Array, held: Weights = ()) -> Array:
    """Probability of being wrong of each answer by weights that were fitted on the other groups."""
    p = np.empty(len(x))
    for name in np.unique(group):
        own = group == name
        p[own] = 1 / (1 + np.exp(np.clip(x[own] @ fitted(x[~own], right[~own], held), -50, 50)))
    return p


def sigma_lines(right: list[CloudAnswer]) -> list[str]:
    """Errors of right answers over the claimed sigmas, by cloud and of all."""
    lines = []
    for cloud in [*sorted({a.cloud for a in right}), ""]:
        some = [a for a in right if cloud in ("", a.cloud)]
        z = np.array([a.error_m / np.sqrt(np.diag(a.covariance_m2)) for a in some])
        inside = np.mean([a.inside for a in some])
        rms = np.sqrt((z**2).mean(0)).round(2)
        lines.append(f"{cloud or 'all'}: rms(error / sigma) {rms}, {100 * inside:.1f} % inside the 95 % ellipse ({len(some)})")
    return lines


if __name__ == "__main__":
    warnings.simplefilter("error")
    main()
