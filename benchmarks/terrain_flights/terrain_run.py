"""One flight against the terrain: stretches are collected until they hold enough, matched, and fused; every answer is judged."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.terrain_flights import terrain_flight as facts
from benchmarks.terrain_flights.terrain_filter import ErrorFilter
from benchmarks.terrain_flights.terrain_flight import SCAN_S, SPEED_MPS, STEP_S, Flight, beam, scan
from benchmarks.terrain_flights.terrain_world import World
from visloc_companion.errors import Reason
from visloc_companion.localise.terrain.base import Kind, NoTerrainFix, Soundings, TerrainFix, TerrainPrior
from visloc_companion.localise.terrain.elevation import ElevationMap
from visloc_companion.localise.terrain.information import expected_sigma_m
from visloc_companion.localise.terrain.match import locate
from visloc_companion.localise.terrain.settings import TerrainSettings
from visloc_companion.localise.terrain.thin import low_in_cells
from visloc_companion.types import FloatArray, Rejected

START_SIGMA_M = 15.0
CHECK_STEPS = round(300 / SPEED_MPS / STEP_S)
THIN_M = 10.0
"""The sensor's own points are thinned to the lowest of such cells as they come."""
TURN_RAD = math.radians(20)
"""A stretch ends in a turn of more than this: the dead reckoning's error changes with the course."""
WANDER = 0.3
"""Of a random walk's spread at its end, what remains when a line is fitted to it."""
BENT = 1 / 20, 3 / 5, 3.0
"""A cubic over a stretch, fitted with a parabola (Legendre's third polynomial): how far off that is at its ends, its slope and
its curvature, by the cubic's height over powers of the time. A random walk of the acceleration bends alike, within a tenth."""
CHECK_GROWTH = 1.3
"""A stretch that does not tell enough is asked again when it is longer by this factor."""
SHORTEST_M = {Kind.PATCH: 900.0, Kind.PROFILE: 1500.0}
LONG_M = {Kind.PATCH: 3000.0, Kind.PROFILE: 6000.0}
LONGEST_M = {Kind.PATCH: 6000.0, Kind.PROFILE: 12000.0}
ENOUGH_M = {Kind.PATCH: 4.0, Kind.PROFILE: 5.2}
AVERAGED = 21
"""Steps over which the barometer's noise is averaged where a height is told of a time that has passed."""
CONTENT = 1.6
"""A stretch is matched when the model promises ENOUGH_M as 1-sigma of its worse axis (CONTENT times that from LONG_M on, but no
more than a fix may claim), and at LONGEST_M in any case; it ends when a match is accepted. What is refused is joined with what
comes. A profile's is that of flight (localise/terrain/answer.py)."""


@dataclass(frozen=True, slots=True)
class Judged:
    """An answer, the errors of its position (north, east) and height where it has one, where it was and what it cost; `then`: of
    the height in the middle of its stretch."""

    answer: TerrainFix | NoTerrainFix
    error_ne_m: FloatArray
    error_h_m: float
    error_h_then_m: float
    region: str
    length_m: float
    cpu_ms: float


@dataclass(slots=True)
class Outcome:
    """All stretches of a flight; the filter's errors and sigmas (north, east, height, height in the middle of the stretch) after
    each; fixes that it refused."""

    judged: list[Judged] = field(default_factory=list)
    filter_error: list[FloatArray] = field(default_factory=list)
    filter_sigma: list[FloatArray] = field(default_factory=list)
    gated: int = 0


class Run:
    """A flight with one sensor."""

    def __init__(
        self, world: World, elevation: ElevationMap, flight: Flight, seed: int, kind: Kind, range_sigma_m: float
    ) -> None:
        self.world, self.elevation, self.flight, self.kind = world, elevation, flight, kind
        self.range_sigma_m = range_sigma_m
        self.rng = np.random.default_rng([seed, 4])
        start = self.rng.normal(0, START_SIGMA_M, 2)
        self.dead_reckoned = flight.p_ne_m + start + np.cumsum(flight.velocity_error_mps, axis=0) * STEP_S
        self.filter = ErrorFilter(flight.drift, START_SIGMA_M, float(flight.course_rad[0]))

    def fly(self, settings: TerrainSettings) -> Outcome:
        """From the first step to the last."""
        outcome, at, last = Outcome(), 0, len(self.flight.p_ne_m) - 1
        while at + 2 * CHECK_STEPS < last:
            at = self._over_a_stretch(outcome, at, last, settings)
        return outcome

    def _over_a_stretch(self, outcome: Outcome, first: int, last: int, settings: TerrainSettings) -> int:
        """Collect and ask until an answer is accepted; a refused stretch is joined with what comes. Returns where it ended."""
        at, soundings, wanted = first, [], SHORTEST_M[self.kind]
        while True:
            until = min(at + CHECK_STEPS, last)
            soundings.append(self._measured(at, until))
            self._carry(at, until)
            at, length = until, (until - first) * STEP_S * SPEED_MPS
            ended = at >= last or length >= LONGEST_M[self.kind]
            if length < wanted and not ended:
                continue
            wanted = CHECK_GROWTH * length
            stretch = self.stretch(soundings, at)
            over = ended or abs(self.flight.course_rad[at] - self.flight.course_rad[first]) > TURN_RAD
            if not over and not self._enough(stretch, at, length, settings):
                continue
            judged = self._match(outcome, stretch, at, length, settings)
            if judged is not None and (over or isinstance(judged.answer, TerrainFix)):
                outcome.judged.append(judged)
            if over or (judged is not None and isinstance(judged.answer, TerrainFix)):
                return at

    def prior(self, step: int, stretch: Soundings) -> TerrainPrior:
        """What the filter believes at a step."""
        x, P = self.filter.x, self.filter.P
        place = self.dead_reckoned[step] - x[:2]
        drift = self.flight.drift
        heading = math.hypot(drift.heading_rad, facts.GYROSCOPE * step * STEP_S if drift.inertial else 0.0)
        cov = ((float(P[0, 0]), float(P[0, 1])), (float(P[0, 1]), float(P[1, 1])))
        sigma_v, sigma_a, wander = self.drift_sigmas(stretch)
        off_h, of_h_m2 = self.filter.height()
        h = float(self.flight.h_reckoned_m[step] - off_h)
        sigma_h = math.hypot(math.sqrt(of_h_m2), self.filter.vertical.noise_m())
        return TerrainPrior(
            *((float(place[0]), float(place[1])), cov, h, sigma_h, heading, drift.tilt_rad, sigma_v, sigma_a, wander),
            self.filter.height_walk(float(stretch.age_s.max())),
        )

    def drift_sigmas(self, stretch: Soundings) -> tuple[float, float, float]:
        """What a prior says of the drift over a stretch: of velocity, acceleration, and of what wanders about these (m)."""
        span = float(stretch.age_s.max())
        sigma_v, sigma_a, sigma_j = self._motion_sigmas()
        bent = math.hypot(self.filter.drift.bend_m(span), sigma_j * span**3 / 6)
        at_end, of_velocity, of_acceleration = BENT
        wander = math.hypot(at_end * bent, WANDER * self.filter.drift.noise_m(span))
        return math.hypot(sigma_v, of_velocity * bent / span), math.hypot(sigma_a, of_acceleration * bent / span**2), wander

    def _motion_sigmas(self) -> FloatArray:
        """(3,) of the filter's velocity, acceleration and its rate, the worse axis each."""
        return np.sqrt(np.maximum(np.diag(self.filter.motion()[1]), 0).reshape(3, 2).max(1))

    def _own_covariance(self, fix: TerrainFix) -> FloatArray:
        """Of a fix (2, 2), without what all share by the model's place, and without what the filter knows of the drift."""
        by = np.array(fix.by_drift) * np.repeat(self._motion_sigmas()[:2], 2)
        return np.asarray(np.array(fix.cov_ne_m2) - np.eye(2) * self.elevation.sigma_ne_m**2 - by @ by.T, dtype=np.float64)

    def stretch(self, measured: list[tuple[FloatArray, FloatArray]], end: int) -> Soundings | None:
        """Points about the beams' origins put together by dead reckoning, relative to the vehicle at a step; None for too few."""
        points = np.concatenate([m[0] for m in measured])
        if len(points) < 30:
            return None
        steps = np.concatenate([m[1] for m in measured])
        age = (end - steps) * STEP_S
        v, a, j = self.filter.motion()[0].reshape(3, 1, 2)
        back = age[:, None]
        moved = self.dead_reckoned[steps] - self.dead_reckoned[end] + back * v - back**2 / 2 * a + back**3 / 6 * j
        climbed = self._reckoned(steps, end) - self.flight.h_reckoned_m[end]
        placed = points + np.column_stack([moved, climbed])
        return Soundings(end * round(STEP_S * 1e9), placed, age, self._sigma_m(), self.kind, points)

    def _sigma_m(self) -> float:
        """Of a sounding's height."""
        return math.hypot(self.range_sigma_m, self.filter.vertical.noise_m())

    def _reckoned(self, steps: NDArray[np.int64], now: int) -> FloatArray:
        """The reckoned height at steps, as if its error had been what it is at the step where the filter stands."""
        return self.flight.h_reckoned_m[steps] - self.filter.height_since((now - steps) * STEP_S)

    def _measured(self, first: int, end: int) -> tuple[FloatArray, FloatArray]:
        if self.kind is Kind.PATCH:
            points, steps = scan(
                self.world, self.flight, np.arange(first, end, round(SCAN_S / STEP_S)), self.rng, self.range_sigma_m
            )
            if not len(points):
                return points, steps
            north_east = points[:, :2] + self.dead_reckoned[steps]
            placed = np.column_stack([north_east, points[:, 2] + self._reckoned(steps, first)])
            low = low_in_cells(placed, THIN_M, self._sigma_m())
            return points[low], steps[low]
        return beam(self.world, self.flight, np.arange(first, end), self.rng, self.range_sigma_m)

    def _enough(self, stretch: Soundings | None, at: int, length: float, settings: TerrainSettings) -> bool:
        if stretch is None:
            return False
        enough = min(ENOUGH_M[self.kind] * (1.0 if length < LONG_M[self.kind] else CONTENT), settings.max_sigma_m)
        return expected_sigma_m(stretch, self.prior(at, stretch), self.elevation, settings) <= enough

    def _carry(self, first: int, end: int) -> None:
        flown = slice(first + 1, end + 1)
        above = self.flight.h_reckoned_m[flown] - self.flight.h_indicated_m[flown]
        self.filter.carry(self.flight.course_rad[flown], above)

    def _match(
        self, outcome: Outcome, stretch: Soundings | None, at: int, length: float, settings: TerrainSettings
    ) -> Judged | None:
        flight = self.flight
        region = self.world.class_at(flight.p_ne_m[at - round(length / 2 / SPEED_MPS / STEP_S)][None])[0]
        if stretch is None:
            return None
        prior = self.prior(at, stretch)
        start = time.process_time()
        answer = locate(stretch, prior, self.elevation, settings)
        took = 1e3 * (time.process_time() - start)
        error, error_h, then_h = np.full(2, np.nan), math.nan, math.nan
        middle_s = float(stretch.age_s.mean())
        self.filter.recall(middle_s)
        off_then = self._reckoned_off(at - middle_s / STEP_S)
        if isinstance(answer, TerrainFix):
            error = np.array(answer.p_ne_m) - flight.p_ne_m[at]
            error_h = answer.h_amsl_m - float(flight.h_amsl_m[at])
            off_then = self._reckoned_off(at - answer.height_age_s / STEP_S)
            drifted = float(self.filter.height_since(np.array([answer.height_age_s]))[0])
            then_h = off_then - drifted - float(flight.h_reckoned_m[at]) + answer.h_amsl_m
            own = self._own_covariance(answer)
            got = self.filter.observe(answer, self.dead_reckoned[at], float(flight.h_reckoned_m[at]), own)
            outcome.gated += isinstance(got, Rejected)
        elif answer.reason is Reason.INCONSISTENT_WITH_PRIOR:
            self.filter.doubt()
        judged = Judged(answer, error, error_h, then_h, region, length, took)
        now = self.dead_reckoned[at] - self.filter.x[:2] - flight.p_ne_m[at]
        high = flight.h_reckoned_m[at] - self.filter.height()[0] - flight.h_amsl_m[at]
        outcome.filter_error.append(np.array([*now, high, off_then - self.filter.then[0]]))
        common_m2 = self.elevation.sigma_ne_m**2  # which no number of fixes averages away
        noise_m2 = self.filter.vertical.noise_m() ** 2
        more_m2 = np.array([common_m2, common_m2, noise_m2, noise_m2 / AVERAGED])
        known_m2 = np.array([self.filter.P[0, 0], self.filter.P[1, 1], self.filter.height()[1], self.filter.then[1]])
        outcome.filter_sigma.append(np.sqrt(known_m2 + more_m2))
        return judged

    def _reckoned_off(self, step: float) -> float:
        """By how much the reckoned height, averaged over two seconds about a step or a part of it, is too high."""
        about = np.clip(step + np.arange(AVERAGED) - AVERAGED // 2, 0, len(self.flight.h_amsl_m) - 1)
        some = np.arange(math.floor(about[0]), math.ceil(about[-1]) + 1)
        return float(np.mean(np.interp(about, some, self.flight.h_reckoned_m[some] - self.flight.h_amsl_m[some])))
