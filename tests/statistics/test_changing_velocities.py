"""Monte-Carlo: error, covariance and level while the velocity that drives the filter is replaced again and again, and while
odometry is deceived now and then."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from visloc_companion.core import estimator
from visloc_companion.core.estimator import PositionFilter
from visloc_companion.core.filter import motion
from visloc_companion.core.filter.belief import Belief, seeded
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.motion import Motion, learned
from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, Fix, GeoPoint, Rejected, Vec2

ORIGIN = GeoPoint(59.3, 18.1, 40.0)
SETTINGS = NavigatorSettings()
DT_S, SECONDS = 0.1, 180.0
INTERVAL_S, FIX_PERIOD_S = 1.2, 9.0
INERTIAL_S, FED_BACK_S = (15.0, 45.0), (0.5, 6.0)
LEG_SIGMA_M, FIX_SIGMA_M = 0.3, 1.0
N_FLIGHTS = 6
DECEIVED, FALSE_MPS = 0.08, 8.0
LARGEST_RMS = 1.25


@dataclass
class Driven:
    """The vehicle, the velocity that drives the filter, and that one's error: an inertial one goes on from the autopilot's and
    drifts, the autopilot's own begins anew."""

    rng: np.random.Generator
    drive: Drive = Drive.FED_BACK
    p_m: np.ndarray = field(default_factory=lambda: np.zeros(2))
    until_s: float = 3.0
    fed_back_s: tuple[float, float] = FED_BACK_S
    b_mps: np.ndarray = field(init=False)
    a_mps2: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.b_mps = SETTINGS.velocity_sigma_aiding_mps * self.rng.standard_normal(2)
        self.a_mps2 = SETTINGS.acceleration_sigma_mps2 * self.rng.standard_normal(2)

    def step(self, t_s: float) -> None:
        """To a time, DT_S later."""
        self.p_m = self.p_m + (self.velocity(t_s - DT_S) + self.velocity(t_s)) / 2 * DT_S
        if self.drive is Drive.INERTIAL:
            noise = INERTIAL_WALK_MPS_PER_SQRT_S * math.sqrt(DT_S) * self.rng.standard_normal(2)
            self.b_mps = self.b_mps + self.a_mps2 * DT_S + noise
            self.a_mps2 = self._gone_on(self.a_mps2, SETTINGS.acceleration_sigma_mps2, SETTINGS.acceleration_correlation_s)
        else:
            self.b_mps = self._gone_on(self.b_mps, SETTINGS.velocity_sigma_aiding_mps, SETTINGS.velocity_correlation_s)
        if t_s >= self.until_s:
            self._replace(t_s)

    def sample(self, t_s: float) -> Velocity:
        north, east = (self.velocity(t_s) + self.b_mps).tolist()
        return Velocity(ns(t_s), (north, east, 0.0), 140.0, 0.8, self.drive, SETTINGS.acceleration_sigma_mps2)

    @staticmethod
    def velocity(t_s: float) -> np.ndarray:
        return 10.0 * np.array([math.cos(t_s / 15), math.sin(t_s / 15)])

    def _replace(self, t_s: float) -> None:
        if self.drive is Drive.INERTIAL:
            self.drive, self.until_s = Drive.FED_BACK, t_s + self.rng.uniform(*self.fed_back_s)
            self.b_mps = SETTINGS.velocity_sigma_aiding_mps * self.rng.standard_normal(2)
        else:
            self.drive, self.until_s = Drive.INERTIAL, t_s + self.rng.uniform(*INERTIAL_S)
            self.a_mps2 = SETTINGS.acceleration_sigma_mps2 * self.rng.standard_normal(2)

    def _gone_on(self, x: np.ndarray, sigma: float, tau_s: float) -> np.ndarray:
        kept = math.exp(-DT_S / tau_s)
        return kept * x + sigma * math.sqrt(1 - kept * kept) * self.rng.standard_normal(2)


def ns(t_s: float) -> int:
    return round(t_s * 1e9)


def flown(seed: int, deceived: float = 0.0) -> tuple[list[float], list[float]]:
    """Errors over sigma on both axes, and over the level, once a second; this share of the intervals is false."""
    rng, lies = np.random.default_rng([seed, 5]), np.random.default_rng([seed, 6])
    driven, seen_from = Driven(rng, fed_back_s=(10.0, 30.0) if deceived else FED_BACK_S), (0.0, np.zeros(2))
    begin = seeded(0, (0.0, 0.0), SETTINGS.seed_sigma_m, 0.8, Drive.FED_BACK, SETTINGS)
    the_filter = PositionFilter(SETTINGS, ORIGIN, begin, driven.sample(0.0))
    over_sigma: list[float] = []
    over_level: list[float] = []
    for k in range(1, round(SECONDS / DT_S) + 1):
        t = k * DT_S
        driven.step(t)
        the_filter.drive(driven.sample(t))
        if k % round(INTERVAL_S / DT_S) == 0:
            d = driven.p_m - seen_from[1] + LEG_SIGMA_M * rng.standard_normal(2)
            if lies.random() < deceived:
                d += INTERVAL_S * lies.uniform(-FALSE_MPS, FALSE_MPS, 2)
            cov = ((LEG_SIGMA_M**2, 0.0), (0.0, LEG_SIGMA_M**2))
            the_filter.observe_motion(Motion(ns(t), ns(seen_from[0]), (float(d[0]), float(d[1])), cov))
            seen_from = (t, driven.p_m)
        if k % round(FIX_PERIOD_S / DT_S) == 0:
            north, east = (driven.p_m + FIX_SIGMA_M * rng.standard_normal(2)).tolist()
            place = wgs84.geo_from_ned((north, east, -100.0), ORIGIN)
            cov = ((FIX_SIGMA_M**2, 0.0), (0.0, FIX_SIGMA_M**2))
            the_filter.observe(Fix(ns(t), ns(t), k, k, "t", place, (1.0, 0.0, 0.0, 0.0), cov, 2.0, 0.1, 0.001, 5.0))
        if k % 10 == 0 and t > 20:
            state = the_filter.at(ns(t))
            error = np.array(state.p_ned_m[:2]) - driven.p_m
            over_sigma += (error / np.sqrt(np.diag(state.cov_ne_m2))).tolist()
            over_level.append(float(np.hypot(*error)) / the_filter.protection_level_m(ns(t)))
    return over_sigma, over_level


def figures(deceived: float = 0.0) -> tuple[float, float]:
    """Root mean square of error over sigma, and the largest error over level, of all flights."""
    flights = [flown(seed, deceived) for seed in range(N_FLIGHTS)]
    every = np.concatenate([over_sigma for over_sigma, _ in flights])
    return float(np.sqrt(np.mean(every**2))), max(max(over_level) for _, over_level in flights)


def test_the_filter_stays_within_what_it_claims() -> None:
    rms, over_level = figures()
    assert rms <= LARGEST_RMS
    assert over_level <= 1.0


def believing(belief: Belief, seen: Motion, travel_ne_m: Vec2, settings: NavigatorSettings) -> tuple[Belief, Accepted | Rejected]:
    """As learned, but a single interval that nothing agrees with is believed against the autopilot's velocity, and none against
    an inertial one."""
    after, outcome = learned(belief, seen, travel_ne_m, settings)
    if after.doubt is None or after.drive is Drive.INERTIAL:
        return after._replace(doubt=None), outcome
    return learned(after._replace(doubt=None), seen, travel_ne_m, settings)


def test_a_filter_that_forgets_the_former_velocity_and_believes_single_intervals_fails_the_same_check(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def forgetting(
        belief: Belief, seen: Motion, travel_ne_m: Vec2, settings: NavigatorSettings
    ) -> tuple[Belief, Accepted | Rejected]:
        return believing(belief._replace(former=None), seen, travel_ne_m, settings)

    monkeypatch.setattr(motion, "excluding", lambda *_: None)
    monkeypatch.setattr(estimator, "learned", forgetting)
    rms, over_level = figures()
    assert rms > LARGEST_RMS
    assert over_level > 1.0


def test_odometry_that_is_deceived_now_and_then_keeps_its_claims() -> None:
    rms, over_level = figures(DECEIVED)
    assert rms <= LARGEST_RMS
    assert over_level <= 1.0


def test_a_filter_that_believes_a_single_interval_fails_the_same_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion, "excluding", lambda *_: None)
    monkeypatch.setattr(estimator, "learned", believing)
    rms, over_level = figures(DECEIVED)
    assert rms > LARGEST_RMS
    assert over_level > 1.0
