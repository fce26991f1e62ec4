"""Monte-Carlo: the filter's claimed covariance fits its error, and an over-confident localiser fails the same check."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.belief import seeded
from visloc_companion.core.driving import Velocity
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.propagation import INERTIAL_WALK_MPS_PER_SQRT_S, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Fix, GeoPoint

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SETTINGS = NavigatorSettings()
SIGMA_A = SETTINGS.acceleration_sigma_mps2
N_FLIGHTS = 20
LASTS_S = 5.0
"""Half of a fix's variance is that of the ground that neighbouring frames look at."""
BAND = (0.8, 1.25)


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


def test_accelerations_that_are_believed_too_much_fail_the_same_check() -> None:
    flights = [normalised_errors(seed, 1.0, Drive.INERTIAL, 2.0, SIGMA_A / 5) for seed in range(N_FLIGHTS)]
    for axis in range(2):
        assert rms([e for flight in flights for e in flight[axis::2]]) > BAND[1]
