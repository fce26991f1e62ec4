"""The one-sided mixture of ground and what stands on it."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.terrain.noise import RANGE_M, HeightNoise, Stated, expected_log_density, parts, refitted, told

NOISE = HeightNoise(1.5)
AT = np.arange(-60, 100, 0.05)


def test_it_is_a_density() -> None:
    inside = np.exp(parts(NOISE, AT).log_density).sum() * 0.05
    assert inside == pytest.approx(1 - NOISE.outliers + NOISE.outliers * 160 / RANGE_M, abs=2e-3)


def test_its_score_is_its_derivative() -> None:
    p = parts(NOISE, AT)
    assert np.abs(np.gradient(p.log_density, 0.05) - p.score).max() < 0.05


def test_what_stands_above_costs_less_than_what_lies_below() -> None:
    above, below = parts(NOISE, np.array([12.0, -12.0])).log_density
    assert above > below + 2


def test_crowns_neither_lift_nor_push() -> None:
    p = parts(NOISE, np.array([14.0]))
    assert abs(p.score[0]) < 1e-3
    assert p.ground[0] < 0.01


def test_sigma_and_share_are_found_again() -> None:
    rng = np.random.default_rng(1)
    d = rng.normal(0, 0.8, 4000) + (rng.random(4000) < 0.4) * rng.uniform(0, 25, 4000)
    found = refitted(NOISE, d, (0.3, 5.0), 30)
    assert found.sigma_m == pytest.approx(0.8, rel=0.1)
    assert found.standing == pytest.approx(0.4, abs=0.06)


def test_a_handful_of_differences_changes_nothing() -> None:
    assert refitted(NOISE, np.zeros(3), (0.3, 5.0)) == NOISE


def test_the_expected_log_density_is_that_of_samples() -> None:
    rng = np.random.default_rng(2)
    d = AT[rng.choice(len(AT), 20000, p=(w := np.exp(parts(NOISE, AT).log_density)) / w.sum())]
    assert expected_log_density(NOISE) == pytest.approx(parts(NOISE, d).log_density.mean(), abs=0.08)


def test_what_a_mixture_tells_is_by_how_much_a_level_scatters_that_is_fitted_to_it() -> None:
    """Levels fitted to many drawn sets of soundings scatter by the square root of 1 / (told P(ground) N) sigma."""
    noise, rng, n = HeightNoise(1.0, standing=0.6), np.random.default_rng(3), 400
    kind = rng.random((500, n))
    drawn = rng.normal(0, 1.0, kind.shape) + np.where(kind < noise.standing, rng.uniform(0, 28, kind.shape), 0)
    drawn = np.where(kind > 1 - noise.outliers, rng.uniform(-100, 100, kind.shape), drawn)
    levels = np.linspace(-0.6, 0.6, 41)
    likeliest = levels[np.argmax([parts(noise, drawn - level).log_density.sum(1) for level in levels], axis=0)]
    ground = 1 - noise.standing - noise.outliers
    assert 1 / (float(np.var(likeliest)) * ground * n) == pytest.approx(told(noise), rel=0.15)
    assert told(noise) < 0.9
    assert told(HeightNoise(1.0, standing=0.0, outliers=0.0)) == pytest.approx(1.0, abs=0.01)


def test_few_soundings_are_held_to_the_sigma_that_is_stated_and_many_are_not() -> None:
    """The likeliest sigma under the statement, of soundings that differ by 4 m where 1.5 m are stated."""
    stated, start = Stated(1.5, 6.0), HeightNoise(1.5, standing=0.0, outliers=1e-9)
    sigmas = np.linspace(1.0, 5.0, 4001)
    found = {}
    for n in (12, 1200):
        d = -4.0 * np.abs(np.random.default_rng(4).normal(0, 1, n))  # below: nothing that stands there
        of_data = -n * np.log(sigmas) - np.square(d).sum() / 2 / sigmas**2
        likeliest = sigmas[np.argmax(of_data + np.array([stated.log_prior(s) for s in sigmas]))]
        found[n] = refitted(start, d, (0.5, 5.0), 40, stated).sigma_m
        assert found[n] == pytest.approx(likeliest, rel=0.03)
        assert refitted(start, d, (0.5, 5.0), 40).sigma_m == pytest.approx(sigmas[np.argmax(of_data)], rel=0.03)
    assert found[12] < 3.4 < 3.8 < found[1200]
    assert stated.log_prior(1.5) == 0.0 > stated.log_prior(3.0)
