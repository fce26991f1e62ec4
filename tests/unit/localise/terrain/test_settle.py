"""Places settled under the model's errors: patches over models that err as models do, and crowns so low that they pass for rough
ground."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np

from visloc_companion.localise.terrain.base import Soundings, TerrainFix
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings

SIGMA_M, CELL_M, FLIGHTS = 1.5, 20.0, 16


def erring(world: SimpleNamespace, ground: object, seed: int) -> ElevationMap:
    """Half of the errors' variance is alike over 60 m, half over 400 m."""
    rng, model = np.random.default_rng(seed), world.elevation(ground, half_m=1500.0, sigma_m=SIGMA_M)
    shape = model.height_amsl_m.shape
    fields = [cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), length / 2 / CELL_M) for length in (60.0, 400.0)]
    errors = sum(SIGMA_M / np.sqrt(2) * field / field.std() for field in fields)
    return replace(model, height_amsl_m=(model.height_amsl_m + errors).astype(np.float32))


def low_crowns(seen: Soundings, seed: int) -> Soundings:
    """Crowns of 2 to 8 m over nearly half of the ground, alike nearby; one sounding of five meets the ground between them."""
    rng, ne = np.random.default_rng([seed, 2]), seen.points_m[:, :2]
    phase = rng.uniform(0, 6, 4)
    wooded = np.sin(ne[:, 0] / 70 + phase[0]) + np.sin(ne[:, 1] / 60 + phase[1]) > 0.1
    tall = 5 + 3 * np.sin(ne[:, 0] / 90 + phase[2]) * np.sin(ne[:, 1] / 110 + phase[3])
    crown = np.where(wooded & (rng.random(len(ne)) < 0.8), tall * rng.uniform(0.75, 1, len(ne)), 0.0)
    return replace(seen, points_m=seen.points_m + crown[:, None] * [0, 0, 1])


def flown(world: SimpleNamespace, wooded: bool) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) errors of the fixes and the same over their sigmas."""
    errors, ratios = [], []
    for seed in range(FLIGHTS):
        ground = world.waves(40, seed=seed)
        seen = world.patch(ground, seed=seed)
        seen = low_crowns(seen, seed) if wooded else seen
        fix = locate(seen, world.prior(20.0), erring(world, ground, seed), TerrainSettings(max_probability_wrong=1.0))
        assert isinstance(fix, TerrainFix)
        errors.append([*np.subtract(fix.p_ne_m, world.true_ne), fix.h_amsl_m - world.true_h])
        ratios.append(errors[-1] / np.sqrt([*np.diag(np.array(fix.cov_ne_m2)), fix.sigma_h_m**2]))
    return np.array(errors), np.array(ratios)


def rms(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.square(values).mean(0)))


def test_a_patch_is_told_by_what_its_ground_does_within_the_models_long_waves(world: SimpleNamespace) -> None:
    errors, ratios = flown(world, wooded=False)
    assert float(np.hypot(*rms(errors)[:2])) < 4.0
    assert ((rms(ratios) > 0.6) & (rms(ratios) < 1.5)).all()


def test_low_crowns_are_told_from_a_rough_ground(world: SimpleNamespace) -> None:
    errors, _ = flown(world, wooded=True)
    assert errors[:, 2].mean() > -1.1
    assert rms(errors)[2] < 1.5
    assert float(np.hypot(*rms(errors)[:2])) < 6.0
