"""Soundings where the model's errors are alike nearby."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np

from visloc_companion.localise.terrain.base import TerrainFix
from visloc_companion.localise.terrain.cells import Cells
from visloc_companion.localise.terrain.correlation import alike
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.whitening import Walk, whitening

SIGMA_M, CELL_M, LONG_M = 1.5, 20.0, 400.0


def long_waves(seed: int, n: int) -> np.ndarray:
    field = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((n, n)), (0, 0), LONG_M / 2 / CELL_M)
    return np.asarray(SIGMA_M * field / field.std())


def off_ne_m(world: SimpleNamespace, seed: int) -> np.ndarray:
    ground = world.waves(40, seed=seed)
    model = world.elevation(ground, half_m=4000.0)
    erring = (model.height_amsl_m + long_waves(seed, len(model.height_amsl_m))).astype(np.float32)
    fix = locate(world.profile(ground), world.prior(20.0), ElevationMap(erring, model.T_ne_pix, SIGMA_M), TerrainSettings())
    assert isinstance(fix, TerrainFix)
    return np.array(fix.p_ne_m) - np.array(world.true_ne)


def one_each(at: np.ndarray) -> Cells:
    """A cell for each sounding."""
    return Cells(np.arange(len(at)), at)


def test_long_waves_of_the_models_errors_hardly_move_a_line(world: SimpleNamespace) -> None:
    off = np.array([off_ne_m(world, seed) for seed in range(12)])
    assert np.sqrt(np.square(off).sum(1).mean()) < 5.5


def test_it_is_the_inverse_of_what_the_differences_have_for_a_covariance() -> None:
    rng = np.random.default_rng(3)
    at, ground, values = rng.uniform(0, 500, (40, 2)), rng.uniform(0.2, 1, 40), rng.normal(0, 1, (40, 3))
    known, age_s = np.arange(40) != 7, rng.uniform(0, 60, 40)
    errors = whitening(one_each(at), 2.0, 0.1, 0.3, Walk(age_s, 0.05), ground, known)
    covariance = 2.0 * alike(at) + np.diag(0.4 / np.where(known, ground, 1e-9)) + 0.05 * np.minimum.outer(age_s, age_s)
    assert np.allclose(covariance @ errors.solved(values), values)


def test_what_is_not_ground_or_not_known_tells_next_to_nothing() -> None:
    at = np.column_stack([np.linspace(0, 1000, 30), np.zeros(30)])
    ground, known = np.where(np.arange(30) < 10, 0.0, 1.0), np.arange(30) >= 5
    crowns = np.where(ground * known > 0, 0.0, 15.0)
    hidden, open_ground = (
        abs(np.ones(30) @ whitening(one_each(at), 2.0, 0.1, 0.3, Walk(np.zeros(30), 0.0), *as_what).solved(crowns))
        for as_what in ((ground, known), (np.ones(30), np.ones(30, bool)))
    )
    assert hidden < 0.05 * open_ground


def test_soundings_of_a_cell_tell_what_their_weighted_mean_does() -> None:
    rng = np.random.default_rng(4)
    at, of = rng.uniform(0, 500, (12, 2)), np.repeat(np.arange(12), 5)
    ground, values = rng.uniform(0.4, 1, 60), rng.normal(0, 1, (60, 2))
    errors = whitening(Cells(of, at), 2.0, 0.1, 0.3, Walk(np.zeros(60), 0.0), ground, np.ones(60, bool))
    weight = ground.reshape(12, 5)
    mean = np.einsum("ck,ckv->cv", weight, values.reshape(12, 5, 2)) / weight.sum(1)[:, None]
    covariance = 2.0 * alike(at) + np.diag(0.1 + 0.3 / weight.sum(1))
    information, under_errors = errors.told(values)
    assert np.allclose(values.T @ errors.solved(values), information)
    assert np.allclose(information, mean.T @ (weights := np.linalg.solve(covariance, mean)))
    assert np.allclose(under_errors, weights.T @ (covariance + 0.1 * (alike(at) - np.eye(12))) @ weights)
