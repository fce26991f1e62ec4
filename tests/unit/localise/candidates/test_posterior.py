from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.errors import CasesError
from visloc_companion.localise.candidates.posterior import KnownPosition, fit_temperature, posterior
from visloc_companion.localise.search import ScoreVolume

HEIGHT, WIDTH, ORIGIN = 60, 90, (100, -20)
V, U = np.mgrid[0:HEIGHT, 0:WIDTH]
EVERYWHERE = np.ones((HEIGHT, WIDTH), np.bool_)


def volume(score: np.ndarray, hypothesis: np.ndarray | None = None) -> ScoreVolume:
    which = np.zeros(score.shape, np.int32) if hypothesis is None else hypothesis.astype(np.int32)
    return ScoreVolume(score.astype(np.float32), which, ORIGIN)


def quadratic(u: float, v: float, W: np.ndarray) -> np.ndarray:
    du, dv = U - u, V - v
    return -0.5 * (W[0, 0] * du * du + 2 * W[0, 1] * du * dv + W[1, 1] * dv * dv)


def test_a_gaussian_has_its_own_moments_and_entropy():
    cov = np.array([[9.0, 3.0], [3.0, 4.0]])
    temperature = 0.02
    score = 0.9 + temperature * quadratic(40.3, 25.8, np.linalg.inv(cov))
    found = posterior(volume(np.maximum(score, -0.99)), EVERYWHERE, temperature)
    assert found.mean_px == pytest.approx((140.3, 5.8), abs=1e-3)
    assert found.cov_px2 == pytest.approx(cov + np.eye(2) / 12, abs=5e-3)
    assert found.entropy == pytest.approx(math.log(2 * math.pi * math.e) + 0.5 * math.log(np.linalg.det(cov)), abs=1e-3)
    assert [(m.u_px, m.v_px) for m in found.modes] == [(140, 6)]
    assert found.ambiguity == pytest.approx(0, abs=1e-6)


def two_hills(second: float) -> ScoreVolume:
    narrow = np.eye(2) / 4
    first_hill, second_hill = np.exp(quadratic(20, 30, narrow)), second * np.exp(quadratic(70, 15, narrow))
    return volume(0.5 * np.maximum(first_hill, second_hill), np.where(second_hill > first_hill, 7, 3))


def test_two_hills_are_two_modes_with_the_odds_of_their_scores():
    temperature = 0.02
    found = posterior(two_hills(1 - 0.02 * math.log(3) / 0.5), EVERYWHERE, temperature)
    assert [(m.u_px, m.v_px, m.hypothesis) for m in found.modes] == [(120, 10, 3), (170, -5, 7)]
    assert found.modes[0].mass + found.modes[1].mass == pytest.approx(1, abs=1e-3)
    assert found.modes[0].mass / found.modes[1].mass == pytest.approx(3, rel=0.05)
    assert found.ambiguity == pytest.approx(1 - found.modes[0].mass)
    assert found.cov_px2[0, 0] == pytest.approx(50**2 * found.modes[0].mass * found.modes[1].mass, rel=0.05)


def test_what_is_not_allowed_or_has_no_score_counts_for_nothing():
    hills = two_hills(1.0)
    left = posterior(hills, U < 45, 0.02)
    assert [(m.u_px, m.v_px) for m in left.modes] == [(120, 10)]
    hills.score[:, :45] = -1
    assert [(m.u_px, m.v_px) for m in posterior(hills, EVERYWHERE, 0.02).modes] == [(170, -5)]
    nothing = posterior(hills, U < 45, 0.02)
    assert nothing.modes == ()
    assert nothing.ambiguity == 1
    assert np.isnan(nothing.mean_px).all()


def test_ripples_on_a_hill_and_plateaus_are_no_modes_of_their_own():
    hill = np.exp(quadratic(40, 30, np.eye(2) / 100)) + 0.003 * np.cos(math.pi * U)
    assert len(posterior(volume(0.5 * hill), EVERYWHERE, 0.02).modes) == 1
    flat = posterior(volume(np.full((HEIGHT, WIDTH), 0.3)), EVERYWHERE, 0.02)
    assert flat.entropy == pytest.approx(math.log(HEIGHT * WIDTH))
    assert sum(m.mass for m in flat.modes) == pytest.approx(1)


def samples(temperature: float, count: int) -> list[KnownPosition]:
    """Volumes of smooth noise with positions drawn from their own posterior."""
    rng, made = np.random.default_rng(2), []
    for _ in range(count):
        centres = [(15 + 30 * k + rng.uniform(-4, 4), 15 + 30 * j + rng.uniform(-4, 4)) for k in range(3) for j in range(2)]
        heights = rng.uniform(0.3, 0.5, 6)
        hills = [h * np.exp(quadratic(u, v, np.eye(2) / 25)) for (u, v), h in zip(centres, heights, strict=True)]
        score = np.max(hills, axis=0)
        p = np.exp(score / temperature).ravel()
        v, u = np.divmod(int(rng.choice(len(p), p=p / p.sum())), WIDTH)
        made.append(KnownPosition(volume(score), EVERYWHERE, (float(u + ORIGIN[0]), float(v + ORIGIN[1]))))
    return made


@pytest.mark.parametrize("temperature", [0.015, 0.04])
def test_the_temperature_that_drew_the_positions_is_found(temperature):
    assert fit_temperature(samples(temperature, 150), 0.5) == pytest.approx(temperature, rel=0.15)


def test_samples_of_unlike_units_share_one_factor():
    mixed = [
        replace(case, unit=unit) for temperature, unit in ((0.02, 1 / 50), (0.04, 1 / 25)) for case in samples(temperature, 60)
    ]
    assert fit_temperature(mixed, 0.5) == pytest.approx(1, rel=0.15)


def test_masses_under_the_fitted_temperature_are_calibrated():
    cases = samples(0.02, 200)
    t = fit_temperature(cases[:100], 0.5)
    claimed, right = [], []
    for case in cases[100:]:
        best = posterior(case.volume, case.allowed, t).modes[0]
        claimed.append(best.mass)
        right.append(math.hypot(best.u_px - case.true_px[0], best.v_px - case.true_px[1]) < 13)
    assert np.mean(right) == pytest.approx(np.mean(claimed), abs=0.1)


def test_samples_without_their_truth_are_refused():
    with pytest.raises(CasesError, match="no samples"):
        fit_temperature([])
    with pytest.raises(CasesError, match="not among the allowed"):
        fit_temperature([KnownPosition(two_hills(1.0), U < 45, (170.0, -5.0))])
