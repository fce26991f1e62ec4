"""The simulated flight's filter claims what its dead reckoning errs by: without any fix, and with fixes put together by it."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from visloc_companion.localise.terrain.base import TerrainFix

SEEDS, LENGTH_M, STEPS = 40, 60_000.0, 60
AFTER_S = (300, 480, 600, 1080)
FIX_STEPS, FIX_SIGMA_M = 600, 4.0
WORLD = SimpleNamespace(size_m=(30_000.0, 32_000.0), ground=lambda ne_m: np.zeros(len(ne_m)))


@pytest.fixture
def parts(load: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The filter, and flights with each dead reckoning."""
    facts = load("terrain_flights.terrain_flight")
    monkeypatch.setattr(facts, "LENGTH_M", LENGTH_M)
    belief = load("terrain_flights.terrain_filter")
    monkeypatch.setattr(belief, "BAROMETER_SAMPLES", STEPS)  # of the height nothing is asked here
    return SimpleNamespace(filter=belief, facts=facts)


def flights(facts: ModuleType, drift: str) -> list[object]:
    """One of each seed."""
    return [facts.make_flight(WORLD, facts.DRIFTS[drift], seed) for seed in range(SEEDS)]


def position_errors(facts: ModuleType, flight: object, seed: int) -> np.ndarray:
    """(T, 2) of the dead reckoning, with an error of the start of 15 m."""
    start = np.random.default_rng([seed, 9]).normal(0, 15.0, 2)
    return start + np.cumsum(flight.velocity_error_mps, axis=0) * facts.STEP_S


def carry(belief: object, flight: object, end: int) -> None:
    """Over STEPS that end at a step."""
    flown = slice(end - STEPS + 1, end + 1)
    belief.carry(flight.course_rad[flown], flight.h_reckoned_m[flown] - flight.h_indicated_m[flown])


def bounds(n_states: int, n: int) -> tuple[float, float]:
    """Between which the mean of n normalised squared errors lies with 99.8 %."""
    return tuple(chi2.ppf([0.001, 0.999], n_states * n) / n)


@pytest.mark.parametrize("drift", ["tactical", "mems"])
def test_without_fixes_a_flight_is_as_far_off_as_its_filter_says(parts: SimpleNamespace, drift: str) -> None:
    facts, found = parts.facts, {after_s: [] for after_s in AFTER_S}
    for seed, flight in enumerate(flights(facts, drift)):
        off = position_errors(facts, flight, seed)
        belief = parts.filter.ErrorFilter(flight.drift, 15.0, flight.course_rad[0])
        for end in range(STEPS, round(AFTER_S[-1] / facts.STEP_S) + 1, STEPS):
            carry(belief, flight, end)
            if (after_s := round(end * facts.STEP_S)) in found:
                found[after_s].append(off[end] @ np.linalg.solve(belief.P[:2, :2], off[end]))
    low, high = bounds(2, SEEDS)
    assert all(low < np.mean(squared) < high for squared in found.values()), {k: np.mean(v) for k, v in found.items()}


def fixed(
    parts: SimpleNamespace, flight: object, off: np.ndarray, belief: object, end: int, rng: np.random.Generator
) -> TerrainFix:
    """Of ground that tells where the stretch as a whole lies, and nothing of how it is bent: what a short single beam has."""
    age = np.arange(FIX_STEPS) * parts.facts.STEP_S
    v, a, j = belief.motion()[0].reshape(3, 1, 2)
    back = age[:, None]
    bent = off[end - np.arange(FIX_STEPS)] - off[end] + back * v - back**2 / 2 * a + back**3 / 6 * j
    place = flight.p_ne_m[end] - bent.mean(0) + rng.normal(0, FIX_SIGMA_M, 2)
    of_v, of_a = float(age.mean()), -float(np.square(age).mean()) / 2
    by_drift = ((of_v, 0.0, of_a, 0.0), (0.0, of_v, 0.0, of_a))
    height = float(flight.h_amsl_m[end] + rng.normal(0, 1.0))
    return TerrainFix(0, tuple(place), ((1.0, 0.0), (0.0, 1.0)), height, 1.0, 0.0, of_v, 1.0, by_drift)


def test_with_fixes_put_together_by_its_own_drift_the_filter_is_as_far_off_as_it_says(parts: SimpleNamespace) -> None:
    facts, before, after = parts.facts, [], []
    for seed, flight in enumerate(flights(facts, "tactical")):
        rng = np.random.default_rng([seed, 11])
        belief = parts.filter.ErrorFilter(flight.drift, 15.0, flight.course_rad[0])
        off = position_errors(facts, flight, seed)
        for end in range(STEPS, len(off) - 1, STEPS):
            carry(belief, flight, end)
            if end % FIX_STEPS:
                continue
            error = off[end] - belief.x[:2]
            before.append(error @ np.linalg.solve(belief.P[:2, :2], error))
            fix = fixed(parts, flight, off, belief, end, rng)
            own = np.eye(2) * FIX_SIGMA_M**2
            belief.observe(fix, flight.p_ne_m[end] + off[end], float(flight.h_reckoned_m[end]), own)
            error = off[end] - belief.x[:2]
            after.append(error @ np.linalg.solve(belief.P[:2, :2], error))
    assert 0.85 < np.sqrt(np.mean(before) / 2) < 1.15
    assert 0.85 < np.sqrt(np.mean(after) / 2) < 1.15
