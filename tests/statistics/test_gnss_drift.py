"""How often the vision-against-GNSS test cries wolf, and how far a drag gets before it is declared."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from visloc_companion.core.satellites.drift import DriftTest
from visloc_companion.core.settings import GnssSettings

SETTINGS = GnssSettings()
MAP_SIGMA_M = 0.5
SPEED_TERM_M = 1.0


def differences(
    rng: np.random.Generator, n: int, period_s: float, fix_sigma_m: float, gnss_m: float, gnss_tau_s: float, bias_m: float
) -> Iterator[np.ndarray]:
    """White fixes, GNSS and map errors that wander (Gauss-Markov), and a constant offset."""
    a, b = math.exp(-period_s / gnss_tau_s), math.exp(-period_s / 10.0)
    noise = rng.standard_normal((n, 3, 2))
    gnss, track = gnss_m * noise[0, 0], MAP_SIGMA_M * noise[0, 1]
    direction = rng.uniform(0, 2 * math.pi)
    offset = bias_m * np.array([math.cos(direction), math.sin(direction)])
    for k in range(n):
        gnss = a * gnss + gnss_m * math.sqrt(1 - a * a) * noise[k, 0]
        track = b * track + MAP_SIGMA_M * math.sqrt(1 - b * b) * noise[k, 1]
        yield gnss + track + fix_sigma_m * noise[k, 2] + offset


def alarm(test: DriftTest, t_s: float, d: np.ndarray, fix_sigma_m: float) -> bool:
    common = MAP_SIGMA_M**2 + SPEED_TERM_M**2 / 2
    test.add(round(t_s * 1e9), (float(d[0]), float(d[1])), fix_sigma_m**2, common)
    return test.log_r > SETTINGS.drift_threshold


@pytest.mark.parametrize(
    ("fix_sigma_m", "gnss_m", "gnss_tau_s", "bias_m"), [(1.5, 1.2, 100.0, 0.0), (2.0, 1.5, 60.0, 3.0), (1.0, 1.5, 30.0, 2.0)]
)
def test_at_most_one_false_alarm_in_ten_hours(fix_sigma_m: float, gnss_m: float, gnss_tau_s: float, bias_m: float) -> None:
    test, alarms, was = DriftTest(SETTINGS.gnss_sigma_m), 0, False
    rng = np.random.default_rng(7)
    for k, d in enumerate(differences(rng, 36_000, 1.0, fix_sigma_m, gnss_m, gnss_tau_s, bias_m)):
        now = alarm(test, float(k), d, fix_sigma_m)
        alarms, was = alarms + (now and not was), now
    assert alarms <= 1


def pulled_m(seed: int, drag_mps: float, period_s: float, fix_sigma_m: float) -> float:
    """How far GNSS is off when it is declared; the drag starts after 120 s, in any direction, on top of a bias of 2 m."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(0, 2 * math.pi)
    drag = drag_mps * np.array([math.cos(heading), math.sin(heading)])
    test = DriftTest(SETTINGS.gnss_sigma_m)
    for k, d in enumerate(differences(rng, round(240 / period_s), period_s, fix_sigma_m, 1.2, 100.0, 2.0)):
        since_s = max(0.0, k * period_s - 120)
        if alarm(test, k * period_s, d + drag * since_s, fix_sigma_m):
            return since_s * drag_mps
    return math.inf


@pytest.mark.parametrize(
    ("drag_mps", "period_s", "fix_sigma_m", "median_m", "max_m"),
    [(1.0, 0.5, 1.0, 10, 14), (1.0, 1.0, 1.5, 11, 15), (1.0, 1.0, 2.0, 12, 15), (0.5, 0.5, 1.5, 10, 14), (5.0, 0.5, 1.5, 20, 26)],
)
def test_a_drag_is_declared_long_before_30_m(
    drag_mps: float, period_s: float, fix_sigma_m: float, median_m: float, max_m: float
) -> None:
    pulled = [pulled_m(seed, drag_mps, period_s, fix_sigma_m) for seed in range(30)]
    assert min(pulled) > 0  # none declared before the drag began
    assert float(np.median(pulled)) <= median_m
    assert max(pulled) <= max_m
