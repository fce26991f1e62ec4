"""What fixes of a single beam claim, how far off they are and what was promised: over wooded hills, with a model that errs as
models do."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from visloc_companion.localise.terrain.base import Kind, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.information import expected_sigma_m
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings

MODELS, BEAMS = 10, 6
LENGTH_M, SPEED_MPS, HIGH_M = 1500.0, 50.0, 700.0
SIGMA_M = 1.5


def alike(rng: np.random.Generator, n: int, length_m: float, cell_m: float = 20.0) -> np.ndarray:
    """(n, n) errors of unit spread, alike over a length."""
    field = cv2.GaussianBlur(rng.standard_normal((n, n)), (0, 0), length_m / 2 / cell_m)
    return np.asarray(field / field.std())


def one_beam(world: SimpleNamespace, ground: object, rng: np.random.Generator) -> tuple[Soundings, np.ndarray]:
    """A line of soundings in any direction that ends at a true place; half of it is wooded, and there one of six is ground."""
    course, true_ne = rng.uniform(0, 2 * np.pi), rng.uniform(-400, 400, 2)
    age = np.arange(0, LENGTH_M, 5.0)[::-1] / SPEED_MPS
    ne = -SPEED_MPS * age[:, None] * np.array([np.cos(course), np.sin(course)])
    wooded = np.sin(SPEED_MPS * age / 80 + rng.uniform(0, 6)) + np.sin(SPEED_MPS * age / 210 + rng.uniform(0, 6)) > 0
    crown = np.where(wooded & (rng.random(len(age)) > 0.16), 12 * rng.uniform(0.75, 1, len(age)), 0)
    up = ground(ne + true_ne) + crown - HIGH_M + rng.normal(0, 0.6, len(age))  # type: ignore[operator]
    return Soundings(9, np.column_stack([ne, up]), age, 0.6, Kind.PROFILE, np.column_stack([0 * ne, up])), true_ne


@pytest.fixture(scope="module")
def fixes(world: SimpleNamespace) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Error (north, east) and claimed covariance of every beam that was accepted, and the 1-sigma promised before."""
    found = []
    for seed in range(MODELS):
        rng, ground = np.random.default_rng(seed), world.waves(60, seed=seed)
        model = world.elevation(ground, sigma_m=SIGMA_M)
        errs = sum(alike(rng, len(model.height_amsl_m), length) for length in (60.0, 400.0)) * SIGMA_M / np.sqrt(2)
        erring = ElevationMap((model.height_amsl_m + errs).astype(np.float32), model.T_ne_pix, SIGMA_M)
        for _ in range(BEAMS):
            seen, true_ne = one_beam(world, ground, rng)
            place = true_ne + rng.normal(0, 20, 2)
            cov = ((400.0, 0.0), (0.0, 400.0))
            prior = TerrainPrior((float(place[0]), float(place[1])), cov, HIGH_M + rng.normal(0, 3), 3.0, sigma_drift_mps=0.05)
            fix = locate(seen, prior, erring, TerrainSettings())
            if isinstance(fix, TerrainFix):
                promised = expected_sigma_m(seen, prior, erring, TerrainSettings())
                found.append((np.array(fix.p_ne_m) - true_ne, np.array(fix.cov_ne_m2), promised))
    return found


def test_errors_of_single_beams_are_as_large_as_they_claim(fixes: list[tuple[np.ndarray, np.ndarray, float]]) -> None:
    squared = np.array([error @ np.linalg.solve(cov, error) / 2 for error, cov, _ in fixes])
    assert len(squared) > 0.7 * MODELS * BEAMS
    assert 0.65 < np.sqrt(squared.mean()) < 1.2
    assert np.mean(2 * squared < 5.99) > 0.9


def test_single_beams_claim_what_was_promised(fixes: list[tuple[np.ndarray, np.ndarray, float]]) -> None:
    ratios = [np.sqrt(np.linalg.eigvalsh(cov)[-1]) / promised for _, cov, promised in fixes]
    assert 0.85 < np.median(ratios) < 1.2
