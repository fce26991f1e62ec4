"""The simulated flight's height is as far off as its filter says, beside the barometer and with fixes put together by it."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.unit.benchmarks.terrain_flights.test_terrain_filter import STEPS, carry
from visloc_companion.localise.terrain.base import TerrainFix

SEEDS, LENGTH_M = 20, 30_000.0
AFTER_S = (60, 300, 480, 588)
FIX_STEPS, FIX_SIGMA_M = 180, 1.0
SETTLED = 1800
WORLD = SimpleNamespace(size_m=(30_000.0, 32_000.0), ground=lambda ne_m: np.zeros(len(ne_m)))
FAR_M2 = ((1e8, 0.0), (0.0, 1e8))


@pytest.fixture
def parts(load: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The filter, and flights."""
    facts = load("terrain_flights.terrain_flight")
    monkeypatch.setattr(facts, "LENGTH_M", LENGTH_M)
    return SimpleNamespace(filter=load("terrain_flights.terrain_filter"), facts=facts)


def flown(parts: SimpleNamespace, drift: str, seed: int) -> tuple[object, object]:
    """A flight and its filter at the start."""
    flight = parts.facts.make_flight(WORLD, parts.facts.DRIFTS[drift], seed)
    return flight, parts.filter.ErrorFilter(flight.drift, 15.0, flight.course_rad[0])


def off_m(flight: object, belief: object, end: int) -> float:
    """Error of the filtered height."""
    return float(flight.h_reckoned_m[end] - belief.height()[0] - flight.h_amsl_m[end])


def test_beside_the_barometer_the_height_is_as_far_off_as_the_filter_says(parts: SimpleNamespace) -> None:
    squared = {after_s: [] for after_s in AFTER_S}
    climbs = {after_s: [] for after_s in AFTER_S}
    for seed in range(SEEDS):
        flight, belief = flown(parts, "tactical", seed)
        climb = np.gradient(flight.h_reckoned_m - flight.h_amsl_m, parts.facts.STEP_S)
        for end in range(STEPS, round(AFTER_S[-1] / parts.facts.STEP_S) + 1, STEPS):
            carry(belief, flight, end)
            if (after_s := round(end * parts.facts.STEP_S)) in squared:
                squared[after_s].append(off_m(flight, belief, end) ** 2 / belief.height()[1])
                at = belief.h + 1
                climbs[after_s].append((climb[end] - belief.x[at]) ** 2 / belief.P[at, at])
    low, high = chi2.ppf([0.001, 0.999], SEEDS) / SEEDS
    for found in (squared, climbs):
        assert all(low < np.mean(of) < high for of in found.values()), {k: np.mean(v) for k, v in found.items()}


def fixed(parts: SimpleNamespace, flight: object, belief: object, end: int, rng: np.random.Generator) -> TerrainFix:
    """Of ground that tells by how much the reckoned height is off in the mean of a stretch."""
    age_s = np.arange(FIX_STEPS) * parts.facts.STEP_S
    off = (flight.h_reckoned_m - flight.h_amsl_m)[end - np.arange(FIX_STEPS)] - belief.height_since(age_s)
    height = float(flight.h_reckoned_m[end] - off.mean() + rng.normal(0, FIX_SIGMA_M))
    none = ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    return TerrainFix(0, tuple(flight.p_ne_m[end]), FAR_M2, height, 2.0, 0.0, float(age_s.mean()), FIX_SIGMA_M, none)


@pytest.mark.parametrize(("drift", "rms_m"), [("tactical", 1.0), ("mems", 1.25)])
def test_with_fixes_the_height_is_as_far_off_as_the_filter_says(parts: SimpleNamespace, drift: str, rms_m: float) -> None:
    now, then, errors = [], [], []
    for seed in range(SEEDS):
        flight, belief = flown(parts, drift, seed)
        rng = np.random.default_rng([seed, 11])
        for end in range(STEPS, len(flight.p_ne_m) - 1, STEPS):
            carry(belief, flight, end)
            if end % FIX_STEPS:
                continue
            fix = fixed(parts, flight, belief, end, rng)
            belief.observe(fix, flight.p_ne_m[end], float(flight.h_reckoned_m[end]), np.array(FAR_M2))
            noise_m2 = belief.vertical.noise_m() ** 2
            off = off_m(flight, belief, end)
            now.append(off**2 / (belief.height()[1] + noise_m2))
            if end > SETTLED:
                errors.append(off)
            step = end - fix.height_age_s / parts.facts.STEP_S
            truth = np.interp(step, np.arange(end), (flight.h_reckoned_m - flight.h_amsl_m)[:end])
            off = truth - belief.then[0]
            then.append(off**2 / (belief.then[1] + noise_m2))
    assert 0.85 < np.sqrt(np.mean(now)) < 1.15
    assert 0.85 < np.sqrt(np.mean(then)) < 1.15
    assert np.sqrt(np.mean(np.square(errors))) < rms_m
