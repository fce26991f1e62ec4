"""What fixes claim of the soundings' noise and of drift, and what ground promises of a track that wanders."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visloc_companion.localise.terrain.base import Soundings, TerrainFix
from visloc_companion.localise.terrain.information import expected_sigma_m
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.thin import lowest

NOISE_M = 2.0


def accepted(soundings: Soundings, prior: object, model: object) -> TerrainFix:
    fix = locate(soundings, prior, model, TerrainSettings())  # type: ignore[arg-type]
    assert isinstance(fix, TerrainFix)
    return fix


def test_a_track_that_may_wander_promises_as_much_less(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    steady = world.prior()
    about = (world.patch(ground), world.elevation(ground), TerrainSettings())
    sure, wandering = (expected_sigma_m(about[0], p, *about[1:]) for p in (steady, replace(steady, sigma_wander_m=6.0)))
    assert wandering == pytest.approx(np.hypot(sure, 6.0))


@pytest.mark.parametrize("drift_mps", [(0.1, 0.0), (0.0, -0.1)])
def test_a_fix_says_by_how_much_a_drift_moves_it(world: SimpleNamespace, drift_mps: tuple[float, float]) -> None:
    """In the mean over grounds: a drift of 6 m moves soundings into other cells, of which others are kept, on each by 0.7 m."""
    off, expected = [], []
    for seed in range(1, 7):
        ground = world.waves(30, seed=seed)
        model, prior = world.elevation(ground), world.prior()
        still = accepted(world.profile(ground), prior, model)
        drifting = accepted(world.profile(ground, drift_mps=tuple(-v for v in drift_mps)), prior, model)
        expected.append(np.array(still.by_drift)[:, :2] @ drift_mps)
        off.append(np.array(drifting.p_ne_m) - np.array(still.p_ne_m) - expected[-1])
        assert np.hypot(*expected[-1]) > 0.3
    size_m = np.hypot(*np.transpose(expected))
    assert np.hypot(*np.mean(off, 0)) < 0.2 + 0.2 * size_m.mean()  # the refinement stops within 0.2 m
    assert np.count_nonzero(np.hypot(*np.transpose(off)) < 0.2 + 0.35 * size_m) >= 5


def noisy_patch(world: SimpleNamespace, ground: object, seed: int) -> Soundings:
    exact = world.patch(ground, seed=seed, half_m=200.0)
    noise = np.random.default_rng([seed, 7]).normal(0, NOISE_M, len(exact.points_m))
    return replace(exact, points_m=exact.points_m + noise[:, None] * [0, 0, 1], sigma_m=NOISE_M)


def test_noise_of_single_soundings_averages_out_and_lifts_nothing(world: SimpleNamespace) -> None:
    ground = world.waves(30)
    model = replace(world.elevation(ground), sigma_m=0.3)
    fixes = [accepted(noisy_patch(world, ground, seed), world.prior(), model) for seed in range(16)]
    off = np.array([[*fix.p_ne_m, fix.h_amsl_m] for fix in fixes]) - [*world.true_ne, world.true_h]
    claimed = np.array([[*np.sqrt(np.diag(np.array(fix.cov_ne_m2))), fix.sigma_h_then_m] for fix in fixes])
    assert 0.4 < np.sqrt(np.square(off / claimed)[:, :2].mean()) < 1.3
    assert abs(off[:, 2].mean()) < 0.3


def test_of_noisy_soundings_of_a_cell_one_is_kept_that_its_noise_did_not_choose() -> None:
    rng = np.random.default_rng(1)
    ne = rng.uniform(0, 1000, (40_000, 2))
    up = rng.normal(0, 1.5, len(ne)) + np.where(rng.random(len(ne)) < 0.3, 15.0, 0.0)
    kept = lowest(Soundings(1, np.column_stack([ne, up]), np.zeros(len(ne)), 1.5), 10.0, most=20_000).points_m
    assert len(kept) > 9500
    assert abs(np.median(kept[:, 2])) < 0.3
    assert np.mean(kept[:, 2] > 8) < 0.05  # of 4 soundings on average, all are up there in 4 %


@pytest.mark.parametrize("half_m", [300.0, 600.0, 1000.0])
def test_a_patch_of_gentle_ground_promises_what_its_match_claims(world: SimpleNamespace, half_m: float) -> None:
    ground = world.waves(12)
    model, prior = replace(world.elevation(ground), sigma_m=1.5), world.prior(sigma_m=30.0)
    patch = world.patch(ground, half_m=half_m)
    claimed = np.linalg.eigvalsh(np.array(accepted(patch, prior, model).cov_ne_m2))[-1]
    assert 0.7 < np.sqrt(claimed) / expected_sigma_m(patch, prior, model, TerrainSettings()) < 1.2
