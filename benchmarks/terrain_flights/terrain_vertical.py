"""How the error of a height goes on, as states of the filter of terrain_filter.py: the height's own error first.

With odometry the height is the barometer's, which walks. An inertial unit has a vertical accelerometer, too: the height is
reckoned with it (`Flight.h_reckoned_m`), and the barometer is a measurement of it ten times a second. What the accelerometer is
stated to err by are states (benchmarks/terrain_flights/terrain_flight.py), each as in the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from benchmarks.terrain_flights import terrain_flight as facts
from benchmarks.terrain_flights.terrain_drift import START_SIGMA_MPS, discrete
from benchmarks.terrain_flights.terrain_flight import DriftModel
from visloc_companion.types import FloatArray

START_SIGMA_H_M = 10.0
WALK_M2PS = 2 * facts.BARO_M**2 / facts.BARO_S
EVENLY = 21
"""Ages over which a mean is taken for soundings that came evenly."""


class Carried(NamedTuple):
    """A step that these states were carried over: its length, courses (T,), ends included, and its transition (n, n)."""

    dt_s: float
    course_rad: FloatArray
    F: FloatArray


Past = Sequence[Carried]
"""The latest of them last."""


class Lagged(NamedTuple):
    """A filter's mean (m,) and covariance (m, m), with rows (m,): of the height's error as the soundings of a stretch tell it in
    their mean, and as it was at their mean age."""

    x: FloatArray
    P: FloatArray
    told: FloatArray
    then: FloatArray


class Vertical(Protocol):
    """The last n states of a filter; whether the barometer is measured beside the height."""

    n: int
    beside_barometer: bool

    def start(self) -> FloatArray:
        """(n, n) covariance at the start."""
        ...

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Transition and covariance of the process noise, (n, n) each, over a time with courses (T,), ends included."""
        ...

    def barometer(self, last: Carried) -> FloatArray | None:
        """(n,): by how much the reckoned height is above the barometer's, in the mean of the samples of the last step; None where
        it is the barometer's."""
        ...

    def since(self, age_s: FloatArray, past: Past) -> FloatArray:
        """(N, n): by how much the error was more at (N,) ages than it is now, as far as the states tell; ages below zero are to
        come."""
        ...

    def lagged(self, x: FloatArray, P: FloatArray, age_s: float, past: Past) -> Lagged:
        """A filter (m,), (m, m) that has these states last, with what it takes to be told of a time that has passed."""
        ...

    def noise_m(self) -> float:
        """1-sigma of a reckoned height beside the states."""
        ...

    def walk(self, P: FloatArray, span_s: float, past: Past) -> float:
        """What the height walks like over a stretch (TerrainPrior.sigma_h_walk) for a covariance (n, n), m/sqrt(s)."""
        ...


class Barometric:
    """State (1,): the barometer's error."""

    n, beside_barometer = 1, False

    def start(self) -> FloatArray:
        """Of a weather that is not known."""
        return np.array([[START_SIGMA_H_M**2]])

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """It walks."""
        return np.eye(1), np.array([[WALK_M2PS * dt_s]])

    def barometer(self, last: Carried) -> FloatArray | None:
        """It is the height itself."""
        return None

    def since(self, age_s: FloatArray, past: Past) -> FloatArray:
        """Nothing is known of it."""
        return np.zeros((len(age_s), 1))

    def lagged(self, x: FloatArray, P: FloatArray, age_s: float, past: Past) -> Lagged:
        """With the error then as one more state: the walk since is subtracted from its variance."""
        h, n = len(x) - 1, len(x) + 1
        wide = np.zeros((n, n))
        wide[:-1, :-1] = P
        wide[-1, :-1] = wide[:-1, -1] = P[h]
        wide[h, -1] = wide[-1, h] = wide[-1, -1] = max(float(P[h, h]) - WALK_M2PS * max(age_s, facts.STEP_S), 1e-6)
        row = np.eye(n)[-1]
        return Lagged(np.append(x, x[h]), wide, row, row)

    def noise_m(self) -> float:
        """Of one sample."""
        return facts.BARO_NOISE_M

    def walk(self, P: FloatArray, span_s: float, past: Past) -> float:
        """As it does."""
        return math.sqrt(WALK_M2PS)


class Inertial:
    """States (8,): error of the height, of the climb, bias of the accelerometers down and to the right, gravity's anomaly, tilt
    (north, east), the barometer's error."""

    n, beside_barometer = 8, True

    def __init__(self, tilt_rad: float) -> None:
        self._tilt_rad = tilt_rad

    def start(self) -> FloatArray:
        """The height is begun by the barometer."""
        P = np.diag(
            np.square(
                [
                    *(math.hypot(START_SIGMA_H_M, facts.BARO_NOISE_M), START_SIGMA_MPS),
                    *(facts.ACCELEROMETER, facts.ACCELEROMETER, facts.ANOMALY),
                    *(self._tilt_rad, self._tilt_rad, START_SIGMA_H_M),
                ]
            )
        )
        P[0, -1] = P[-1, 0] = START_SIGMA_H_M**2
        return P

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By the error equations; gravity is reckoned for the barometer's height."""
        lasts_s = np.array([facts.ANOMALY_M / facts.SPEED_MPS, facts.TILT_S, facts.TILT_S, facts.BARO_S])
        sigma = np.array([facts.ANOMALY, self._tilt_rad, self._tilt_rad, facts.BARO_M])
        A = np.zeros((8, 8))
        A[0, 1] = 1.0
        A[1] = self._acceleration(course_rad)
        A[4:, 4:] = -np.diag(1 / lasts_s)
        return discrete(A, np.array([0, facts.VELOCITY_WALK**2, 0, 0, *(2 * np.square(sigma) / lasts_s)]), dt_s)

    def barometer(self, last: Carried) -> FloatArray | None:
        """Its samples are of the time since the last ones."""
        age_s = np.arange(len(last.course_rad) - 1) * facts.STEP_S
        row = np.eye(8)[0] - np.eye(8)[-1] + self.since(age_s, [last]).mean(0)
        return np.asarray(row, dtype=np.float64)

    def since(self, age_s: FloatArray, past: Past) -> FloatArray:
        """Back through the transitions, ahead by the acceleration now."""
        if not past:
            return np.zeros((len(age_s), 8))
        rows, ages_s = [np.eye(8)[0]], [0.0]
        for step in reversed(past):
            if ages_s[-1] >= age_s.max():
                break
            rows.append(np.linalg.solve(step.F.T, rows[-1]))
            ages_s.append(ages_s[-1] + step.dt_s)
        known = np.array(rows)
        back = np.column_stack([np.interp(age_s, ages_s, known[:, k]) for k in range(8)]) - known[0]
        ahead_s = np.maximum(-age_s, 0.0)[:, None]
        acceleration = self._acceleration(past[-1].course_rad)
        return np.asarray(back + ahead_s * np.eye(8)[1] + np.square(ahead_s) / 2 * acceleration, dtype=np.float64)

    def lagged(self, x: FloatArray, P: FloatArray, age_s: float, past: Past) -> Lagged:
        """The states tell what was."""
        then, told = np.zeros(len(x)), np.zeros(len(x))
        then[-8:] = np.eye(8)[0] + self.since(np.array([age_s]), past)[0]
        told[-8:] = np.eye(8)[0] + self.since(np.linspace(0, 2 * age_s, EVENLY), past).mean(0)
        return Lagged(x, P, told, then)

    def noise_m(self) -> float:
        """It has none."""
        return 0.0

    def walk(self, P: FloatArray, span_s: float, past: Past) -> float:
        """As a walk whose mean over the stretch is as far from its end."""
        row = self.since(np.array([span_s / 2]), past)[0]
        return math.sqrt(3 * float(row @ P @ row) / span_s)

    def _acceleration(self, course_rad: FloatArray) -> FloatArray:
        """(8,) of the error of the upward acceleration in the mean over courses (T,), evenly STEP_S apart."""
        of_sensors = facts.felt(course_rad).mean(0)
        return np.array([0, 0, *of_sensors[:2], 1.0, *of_sensors[2:], 2 * facts.GRAVITY / facts.EARTH_M])


def vertical_of(model: DriftModel) -> Vertical:
    """The states of a height."""
    return Inertial(model.tilt_rad) if model.inertial else Barometric()
