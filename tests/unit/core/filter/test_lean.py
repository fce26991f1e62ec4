"""Fixes that come out on one side show an odometry that is wrong by more than it claims."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter import fusion, lean
from visloc_companion.core.filter.belief import Belief, Position, seeded
from visloc_companion.core.filter.motion import Motion, learned
from visloc_companion.core.filter.propagation import ODOMETRY_SCALE, Drive
from visloc_companion.core.settings import NavigatorSettings

SETTINGS = NavigatorSettings()
S = 1_000_000_000


def test_independent_fixes_do_not_lean() -> None:
    rng = np.random.default_rng(1)
    S_m2 = np.array([[2.0, 0.5], [0.5, 1.0]])
    draws = rng.multivariate_normal((0.0, 0.0), S_m2, 20_000)
    mean, n = lean.UPRIGHT, 0
    for innovation in draws:
        mean = lean.leaning(mean, lean.whitened(innovation, S_m2))
        n += lean.leans(mean)
    assert n <= 3


def test_fixes_on_one_side_lean_within_a_dozen() -> None:
    mean, n = lean.UPRIGHT, 0
    while not lean.leans(mean):
        mean, n = lean.leaning(mean, (1.2, 1.2)), n + 1
    assert 5 <= n <= 15


def followed(scale: float, seconds: int, seed: int = 1) -> tuple[Belief, list[float]]:
    """A flight at 10 m/s on accelerations, odometry that sees too much by `scale` and claims 2 %, two fixes a second."""
    rng = np.random.default_rng(seed)
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.8, Drive.AUTOPILOT, SETTINGS), 0.1)
    errors = []
    for k in range(1, 2 * seconds + 1):
        belief = fusion.propagated(belief, k * S // 2, (10.0, 0.0), SETTINGS)
        seen = Motion(k * S // 2, (k - 1) * S // 2, (5.0 * (1 + scale), 0.0), ((0.01, 0.0), (0.0, 0.01)), 0.02, math.radians(1.0))
        belief, _ = learned(belief, seen, (5.0, 0.0), SETTINGS)
        at = (5.0 * k + 0.7 * float(rng.standard_normal()), 0.7 * float(rng.standard_normal()))
        belief, _ = fusion.observed(belief, Position(k * S // 2, at, ((0.5, 0.0), (0.0, 0.5)), from_fix=True), SETTINGS)
        errors.append(float(belief.x[0]) - 5.0 * k)
    return belief, errors


def test_a_scale_far_beyond_its_claim_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    belief, errors = followed(0.15, 40)
    assert np.abs(errors[-20:]).max() < 1.0
    assert belief.x[ODOMETRY_SCALE] == pytest.approx(0.15, abs=0.04)
    monkeypatch.setattr(lean, "LEAN_SIGMA", math.inf)
    _, held = followed(0.15, 40)
    assert np.mean(held[:40]) > 1.2 * np.mean(errors[:40])


def test_an_honest_scale_is_not_doubted() -> None:
    belief, _ = followed(0.0, 60)
    assert belief.P[ODOMETRY_SCALE, ODOMETRY_SCALE] < 0.02**2
