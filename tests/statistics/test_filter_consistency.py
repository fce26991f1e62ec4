"""Monte-Carlo: the filter's claimed covariance fits its error, and an over-confident localiser fails the same check."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SETTINGS = NavigatorSettings()
SIGMA_A = SETTINGS.acceleration_sigma_mps2
N_FLIGHTS, N_WRONG = 20, 6
"""Flights of a check; and of one that fails by far (2.6 and 1.9 where 1.25 is allowed)."""
LASTS_S = 5.0
"""Half of a fix's variance is that of the ground that neighbouring frames look at."""
BAND = (0.8, 1.25)
TILT_S = (0.0, 0.75, 2.0, 3.5, 5.0, 6.0, 7.5, 8.0)
TILT_MPS2 = (0.0, 0.035, 0.047, 0.041, 0.028, 0.017, 0.004, 0.0)
"""How ArduCopter's accelerations erred after a correction of 1 m (regression over a flight with a fix in 2 s, R² 0.62)."""


def ns(t_s: float) -> int:
    return round(t_s * 1e9)


def fix_at(t_s: float, ne_m: np.ndarray, sigma_m: float, frame_id: int) -> Fix:
    place = wgs84.geo_from_ned((float(ne_m[0]), float(ne_m[1]), -100.0), ORIGIN)
    cov = ((sigma_m**2, 0.0), (0.0, sigma_m**2))
    return Fix(ns(t_s) + 300_000_000, ns(t_s), frame_id, frame_id, "t", place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, 0.001, 5.0)


class DrivingError:
    """The error of the velocity that drives the filter, as the filter models it."""

    def __init__(self, drive: Drive, rng: np.random.Generator) -> None:
        self.sigma_v = SETTINGS.velocity_sigma_mps if drive is Drive.AUTOPILOT else SETTINGS.velocity_sigma_aiding_mps
        self._drive, self._rng = drive, rng
        self.b = self.sigma_v * rng.standard_normal(2)
        self._a = SIGMA_A * rng.standard_normal(2)

    def step(self, dt_s: float) -> None:
        if self._drive is Drive.INERTIAL:
            keep = math.exp(-dt_s / SETTINGS.acceleration_correlation_s)
            self.b = self.b + self._a * dt_s + INERTIAL_WALK_MPS_PER_SQRT_S * math.sqrt(dt_s) * self._rng.standard_normal(2)
            self._a = keep * self._a + SIGMA_A * math.sqrt(1 - keep * keep) * self._rng.standard_normal(2)
        else:
            keep = math.exp(-dt_s / SETTINGS.velocity_correlation_s)
            self.b = keep * self.b + self.sigma_v * math.sqrt(1 - keep * keep) * self._rng.standard_normal(2)


def normalised_errors(
    seed: int, claimed_share: float, drive: Drive, fix_period_s: float, claimed_sigma_a: float = SIGMA_A
) -> list[float]:
    """Errors over claimed sigma, both axes, through one flight of 150 s with 30 s without fixes at the end."""
    rng = np.random.default_rng(seed)
    dt = 0.1
    p, error = np.zeros(2), DrivingError(drive, rng)
    map_error = SETTINGS.map_sigma_m * rng.standard_normal(2)
    kept, lasting = math.exp(-fix_period_s / LASTS_S), rng.standard_normal(2)

    def velocity(t_s: float) -> np.ndarray:
        return 10.0 * np.array([math.cos(t_s / 15), math.sin(t_s / 15)])

    def sample(t_s: float) -> Velocity:
        v = velocity(t_s) + error.b
        return Velocity(ns(t_s), (float(v[0]), float(v[1]), 0.0), 140.0, error.sigma_v, drive, claimed_sigma_a)

    start = p + SETTINGS.seed_sigma_m * rng.standard_normal(2)
    at = (float(start[0]), float(start[1]))
    begin = seeded(0, at, SETTINGS.seed_sigma_m, error.sigma_v, drive, SETTINGS)
    kalman_filter = PositionFilter(SETTINGS, ORIGIN, begin, sample(0.0))
    errors: list[float] = []
    for k in range(1, 1501):
        t = k * dt
        p = p + (velocity(t - dt) + velocity(t)) / 2 * dt
        error.step(dt)
        kalman_filter.drive(sample(t))
        if t < 120 and k % round(fix_period_s / dt) == 0:
            sigma = float(rng.uniform(0.7, 2.0))
            lasting = kept * lasting + math.sqrt(1 - kept * kept) * rng.standard_normal(2)
            measured = p + map_error + sigma * math.sqrt(0.5) * (lasting + rng.standard_normal(2))
            kalman_filter.observe(fix_at(t, measured, sigma * claimed_share, k))
        if k % 50 == 0:
            state = kalman_filter.at(ns(t))
            for axis in range(2):
                errors.append(float(state.p_ned_m[axis] - p[axis]) / math.sqrt(state.cov_ne_m2[axis][axis]))
    return errors


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(
    ("drive", "fix_period_s"),
    [(Drive.AUTOPILOT, 0.5), (Drive.FED_BACK, 2.0), (Drive.INERTIAL, 0.5), (Drive.INERTIAL, 2.0)],
)
def test_error_over_sigma_is_near_one_per_axis(drive: Drive, fix_period_s: float) -> None:
    flights = [normalised_errors(seed, 1.0, drive, fix_period_s) for seed in range(N_FLIGHTS)]
    for axis in range(2):
        assert BAND[0] <= rms([e for flight in flights for e in flight[axis::2]]) <= BAND[1]


def test_an_over_confident_localiser_fails_the_same_check() -> None:
    flights = [normalised_errors(seed, 1 / 3, Drive.AUTOPILOT, 0.5) for seed in range(N_FLIGHTS)]
    for axis in range(2):
        assert rms([e for flight in flights for e in flight[axis::2]]) > BAND[1]


def test_accelerations_that_are_believed_too_much_fail_the_same_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fusion, "TILT_MPS2_PER_M", 0.0)
    flights = [normalised_errors(seed, 1.0, Drive.INERTIAL, 2.0, SIGMA_A / 5) for seed in range(N_WRONG)]
    for axis in range(2):
        assert rms([e for flight in flights for e in flight[axis::2]]) > BAND[1]


def tilting_flight(seed: int, share: float) -> tuple[list[float], float]:
    """Errors over claimed sigma of 150 s with a fix in 2 s, where each correction tilts the autopilot; and the largest error, m.

    The vehicle stands still; `share`: of the tilt that ArduCopter's own simulator showed.
    """
    rng, dt, sigma_m, sigma_a = np.random.default_rng(seed), 0.1, 0.7, 0.05
    b, largest_m = 0.3 * rng.standard_normal(2), 0.0
    errors: list[float] = []
    corrections: list[tuple[float, np.ndarray]] = []

    def sample(t_s: float) -> Velocity:
        return Velocity(ns(t_s), (float(b[0]), float(b[1]), 0.0), 140.0, 0.8, Drive.INERTIAL, sigma_a)

    begin = seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.INERTIAL, SETTINGS)._replace(sigma_a_mps2=sigma_a)
    kalman_filter = PositionFilter(SETTINGS, ORIGIN, begin, sample(0.0))
    for k in range(1, 1501):
        t = k * dt
        tilted = [share * step * np.interp(t - at_s, TILT_S, TILT_MPS2, right=0.0) for at_s, step in corrections[-6:]]
        b = b + np.sum(tilted, axis=0) * dt + 0.03 * math.sqrt(dt) * rng.standard_normal(2)
        kalman_filter.drive(sample(t))
        if k % 20 == 0:
            before = np.array(kalman_filter.at(ns(t)).p_ned_m[:2])
            kalman_filter.observe(fix_at(t - 0.3, sigma_m * rng.standard_normal(2), sigma_m, k))
            corrections.append((t, np.array(kalman_filter.at(ns(t)).p_ned_m[:2]) - before))
        if k % 10 == 0 and t > 20:
            state = kalman_filter.at(ns(t))
            errors += [state.p_ned_m[axis] / math.sqrt(state.cov_ne_m2[axis][axis]) for axis in range(2)]
            largest_m = max(largest_m, math.hypot(*state.p_ned_m[:2]))
    return errors, largest_m


def test_a_filter_that_reckons_with_the_tilt_of_its_corrections_does_not_swing() -> None:
    """Twice as much as was measured leaves it within what it claims."""
    flights = [tilting_flight(seed, 2.0) for seed in range(4)]
    assert rms([e for errors, _ in flights for e in errors]) <= BAND[1]
    assert max(largest_m for _, largest_m in flights) < 10.0


def test_a_filter_that_does_not_swings_until_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fusion, "TILT_MPS2_PER_M", 0.0)
    assert max(tilting_flight(seed, 2.0)[1] for seed in range(4)) > 50.0
