from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.filter.propagation import (
    ACCELERATION,
    HEADING,
    LASTING,
    N_STATES,
    POSITION,
    VELOCITY,
    Drive,
    initial_covariance,
    step,
)
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

SETTINGS = NavigatorSettings()
SIGMA_A = 0.2
V, A = VELOCITY.start, ACCELERATION.start


def gone_on(dt_s: float, drive: Drive, change: tuple[float, float] = (0.0, 0.0)) -> tuple[FloatArray, FloatArray]:
    """F and Q, with a way of a tenth of what makes ground other ground a second."""
    on = step(dt_s, drive, SIGMA_A, change, SETTINGS, 0.1 * dt_s)
    return on.F, on.Q + 0.8**2 * on.V


@given(st.floats(1e-3, 20), st.floats(1e-3, 20), st.sampled_from(list(Drive)))
def test_two_steps_are_one_longer_step(first_s: float, second_s: float, drive: Drive) -> None:
    (F1, Q1), (F2, Q2), (F, Q) = gone_on(first_s, drive), gone_on(second_s, drive), gone_on(first_s + second_s, drive)
    np.testing.assert_allclose(F2 @ F1, F, atol=1e-9)
    np.testing.assert_allclose(F2 @ Q1 @ F2.T + Q2, Q, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("drive", list(Drive))
@pytest.mark.parametrize("dt_s", [1e-3, 0.1, 60.0])
def test_the_noise_is_a_covariance(drive: Drive, dt_s: float) -> None:
    _, Q = gone_on(dt_s, drive)
    np.testing.assert_allclose(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() >= -1e-15 * np.trace(Q)


def test_an_inertial_velocity_errs_as_its_simulated_accelerations_do() -> None:
    """Against Monte-Carlo: 20 s of a Gauss-Markov acceleration error integrated twice."""
    rng = np.random.default_rng(5)
    dt, n, tau = 0.05, 20_000, SETTINGS.acceleration_correlation_s
    keep = math.exp(-dt / tau)
    a, b, p = SIGMA_A * rng.standard_normal(n), np.zeros(n), np.zeros(n)
    for _ in range(400):
        p -= (b + a * dt / 2) * dt
        b += a * dt + 0.12 * math.sqrt(dt) * rng.standard_normal(n)
        a = keep * a + SIGMA_A * math.sqrt(1 - keep**2) * rng.standard_normal(n)
    F, Q = gone_on(20.0, Drive.INERTIAL)
    P = F @ initial_covariance(0.0, 0.0, SIGMA_A) @ F.T + Q
    assert math.sqrt(P[0, 0]) == pytest.approx(float(p.std()), rel=0.02)
    assert math.sqrt(P[V, V]) == pytest.approx(float(b.std()), rel=0.02)
    assert P[0, V] == pytest.approx(float(np.mean(p * b)), rel=0.04)
    assert P[V, A] == pytest.approx(float(np.mean(b * a)), rel=0.04)


def test_it_fits_a_real_copter() -> None:
    """RMS of the velocity error against its receiver, m/s, of a flight of 2014 (two sensors, 50 Hz, attitude at 10 Hz)."""
    for seconds, low, high in ((2.0, 0.47, 0.54), (5.0, 1.03, 1.24), (10.0, 1.89, 2.33), (20.0, 3.41, 4.33)):
        F, Q = gone_on(seconds, Drive.INERTIAL)
        sigma = math.sqrt((F @ initial_covariance(0.0, 0.0, SETTINGS.acceleration_sigma_mps2) @ F.T + Q)[V, V])
        assert 0.8 * low <= sigma <= 1.2 * high


def test_a_false_heading_turns_the_change_of_velocity() -> None:
    """Heading 0.1 rad too far clockwise: a true acceleration north is taken for one with a part to the east."""
    F, _ = gone_on(2.0, Drive.INERTIAL, (6.0, 0.0))
    x = np.zeros(N_STATES)
    x[HEADING] = 0.1
    after = F @ x
    np.testing.assert_allclose(after[VELOCITY], [0.0, 0.6])
    np.testing.assert_allclose(after[POSITION], [0.0, -0.6])


def test_only_an_inertial_velocity_feels_acceleration_and_heading() -> None:
    for drive in (Drive.AUTOPILOT, Drive.FED_BACK):
        F, Q = gone_on(1.0, drive, (6.0, 0.0))
        for M in (F, Q):
            assert not M[: ACCELERATION.start, ACCELERATION].any()
            assert not M[:HEADING, HEADING:].any()


@pytest.mark.parametrize("drive", list(Drive))
def test_what_fixes_have_in_common_goes_by_with_the_way_and_keeps_its_size(drive: Drive) -> None:
    F, Q = gone_on(10.0, drive)
    kept = math.exp(-1.0)
    np.testing.assert_allclose(F[LASTING, LASTING], kept * np.eye(2))
    np.testing.assert_allclose(F[LASTING, LASTING] @ F[LASTING, LASTING].T + Q[LASTING, LASTING], np.eye(2))
    hovering = step(10.0, drive, SIGMA_A, (0.0, 0.0), SETTINGS).F
    np.testing.assert_array_equal(hovering[LASTING, LASTING], np.eye(2))
