"""The fitted constants of terrain matching: `python -m benchmarks.terrain_fit` (seeds 100 and 101, which no table uses).

Stretches of training flights are matched under priors of several widths, some of which exclude the truth (0.3, 1 km; 4 km off):
the probability of being wrong is a ridge-regularised logistic regression on what is known of each match. Of the right ones errors
over claimed sigmas are printed: the covariance has no factor that was fitted to them.
"""

from __future__ import annotations

import argparse
import math
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.terrain_flights.terrain_flight import DRIFTS, make_flight
from benchmarks.terrain_flights.terrain_run import Run
from benchmarks.terrain_flights.terrain_world import elevation_model, make_world
from visloc_companion.localise.terrain.base import Kind, NoTerrainFix, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.verify import RIGHT_M, RIGHT_SIGMAS, Evidence
from visloc_companion.types import FloatArray

OPEN = TerrainSettings(max_probability_wrong=1.0, max_sigma_m=math.inf)
LENIENT = TerrainSettings(max_probability_wrong=0.5)
"""With which the flights are flown: poor stretches are to be among the samples, and the flight is not to be lost for them."""
RIDGE = 0.3
WIDER_M = (300.0, 1000.0)
FALSE_M = 4000.0
FLIGHTS = (
    ("scanner", "tactical", 20.0, Kind.PATCH, 0.3),
    ("stereo", "mems", 30.0, Kind.PATCH, 1.5),
    ("altimeter", "mems", 20.0, Kind.PROFILE, 0.5),
)


@dataclass(frozen=True, slots=True)
class Sample:
    """A match, how far off it is (m) and that in its own sigmas: north, east, height."""

    evidence: Evidence
    off_m: float
    sigmas: FloatArray
    flight: str

    @property
    def wrong(self) -> bool:
        """Another place (verify.py)."""
        return self.off_m > max(RIGHT_M, RIGHT_SIGMAS * self.evidence.sigma_m)


class _Collecting(Run):
    """A flight that keeps what it asked."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.asked: list[tuple[Soundings, TerrainPrior, int]] = []

    def _match(self, outcome, stretch, at, length, settings):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        if stretch is not None:
            self.asked.append((stretch, self.prior(at, stretch), at))
        return super()._match(outcome, stretch, at, length, settings)


def main() -> None:
    """Collect, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[100, 101])
    parser.add_argument("--every", type=int, default=6, help="use each so many-th stretch under the wider priors")
    parser.add_argument("--keep", type=Path, help="write the samples to this file (pickle)")
    parser.add_argument("--kept", type=Path, nargs="*", help="fit to samples that were written before")
    args = parser.parse_args()
    if args.kept:
        samples = [s for path in args.kept for s in pickle.loads(path.read_bytes())]
    else:
        samples = [s for seed in args.seeds for s in collected(seed, args.every)]
    if args.keep:
        args.keep.write_bytes(pickle.dumps(samples))
    _report(samples)


def _report(samples: list[Sample]) -> None:
    limit = TerrainSettings()
    judged = [s for s in samples if usable(s.evidence)]
    print(f"{len(samples)} matches, {len(judged)} beyond the fixed limits, {sum(s.wrong for s in judged)} of these wrong")
    for flight in FLIGHTS:
        tracked = [s.sigmas for s in judged if s.flight == flight[0] and not s.wrong and s.evidence.sigma_m <= limit.max_sigma_m]
        if tracked:
            ratio = np.array(tracked)
            rms, median = np.sqrt(np.mean(np.square(ratio), axis=0)), 1.4826 * np.median(np.abs(ratio), axis=0)
            print(f"{flight[0]}: {len(ratio)}, error/sigma (N, E, h): rms {rms.round(2)}, of the median {median.round(2)}")
    X = np.array([s.evidence.regressors() for s in judged])
    y = np.array([not s.wrong for s in judged], np.float64)
    weights = fitted(X, y)
    p = 1 / (1 + np.exp(np.clip(X @ weights, -50, 50)))
    print("WEIGHTS =", tuple(float(f"{w:.3g}") for w in weights))
    taken = p <= limit.max_probability_wrong
    wrong = taken & (y < 0.5)
    print(f"AUC {auc(p, y < 0.5):.4f}; accepted: {taken.sum() - wrong.sum()} of {int(y.sum())} right, {wrong.sum()} wrong")


def usable(evidence: Evidence) -> bool:
    """What the fixed limits do not refuse already (verify.py)."""
    return evidence.gain >= 5 and evidence.reliability >= 0.2 and evidence.converged == 1


def collected(seed: int, every: int) -> list[Sample]:
    """Matches of a training world."""
    world = make_world(seed)
    found = []
    for label, name, cell, kind, sigma in FLIGHTS:
        elevation = elevation_model(world, cell, seed)
        flight = make_flight(world, DRIFTS[name], seed)
        run = _Collecting(world, elevation, flight, seed, kind, sigma)
        run.fly(LENIENT)
        rng = np.random.default_rng(seed)
        for k, (stretch, prior, at) in enumerate(run.asked):
            truth = np.array([*flight.p_ne_m[at], flight.h_amsl_m[at]])
            found += _sampled(stretch, prior, elevation, truth, label)
            if k % every:
                continue
            for wide in WIDER_M:
                place = truth[:2] + rng.normal(0, wide, 2)
                found += _sampled(stretch, _moved(prior, place, wide), elevation, truth, "wide prior")
            angle = rng.uniform(0, 2 * math.pi)
            place = truth[:2] + FALSE_M * np.array([math.cos(angle), math.sin(angle)])
            found += _sampled(stretch, _moved(prior, place, WIDER_M[0]), elevation, truth, "wide prior")
    return found


def _moved(prior: TerrainPrior, place: FloatArray, sigma: float) -> TerrainPrior:
    cov = ((sigma**2, 0.0), (0.0, sigma**2))
    return replace(prior, p_ne_m=(float(place[0]), float(place[1])), cov_ne_m2=cov, sigma_h_m=max(prior.sigma_h_m, 5.0))


def _sampled(stretch: Soundings, prior: TerrainPrior, elevation: ElevationMap, truth: FloatArray, label: str) -> list[Sample]:
    answer = locate(stretch, prior, elevation, OPEN)
    if isinstance(answer, NoTerrainFix):
        return []
    assert isinstance(answer, TerrainFix)
    numbers = dict(answer.evidence)
    evidence = Evidence(**{name: value for name, value in numbers.items() if name != "probability_wrong"})
    error = np.array([*answer.p_ne_m, answer.h_amsl_m]) - truth
    sigma = np.sqrt([answer.cov_ne_m2[0][0], answer.cov_ne_m2[1][1], answer.sigma_h_m**2])
    return [Sample(evidence, float(np.hypot(error[0], error[1])), error / sigma, label)]


def fitted(X: FloatArray, y: FloatArray) -> FloatArray:
    """Logistic regression of being right, by Newton's method."""
    w = np.zeros(X.shape[1])
    for _ in range(60):
        p = 1 / (1 + np.exp(-np.clip(X @ w, -50, 50)))
        H = (X.T * (p * (1 - p))) @ X + RIDGE * np.eye(len(w))
        w += np.linalg.solve(H, X.T @ (y - p) - RIDGE * w)
    return w


def auc(score: FloatArray, positive: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    """Probability that a positive scores above a negative."""
    rank = np.argsort(np.argsort(score)) + 1
    n, m = int(positive.sum()), int((~positive).sum())
    return float((rank[positive].sum() - n * (n + 1) / 2) / max(n * m, 1))


if __name__ == "__main__":
    main()
