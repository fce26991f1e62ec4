"""How the errors of a dead reckoning of `benchmarks/terrain_flights/terrain_flight.py` go on, as a filter's states.

Each error that a sensor is stated to have is a state in the axes in which it is constant: a body's biases and a heading's error
turn with the course, which the vehicle knows.

Inertial (two uncoupled Schuler loops; Titterton & Weston, Strapdown Inertial Navigation Technology, 2004, ch. 12): position,
velocity, acceleration (all north, east; of the last the tilt's part and the bias's together), and of the body the bias of the
accelerometers and the drift of the gyroscopes times gravity. Levelled at the start: tilt and bias cancel, until a turn sets the
bias free.

Odometry: position, noise of the velocity (north, east), scale and heading error times the speed, each first-order Gauss-Markov.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from scipy.linalg import expm  # type: ignore[import-untyped]

from benchmarks.terrain_flights import terrain_flight as facts
from benchmarks.terrain_flights.terrain_flight import DriftModel
from visloc_companion.types import FloatArray

START_SIGMA_MPS, START_SIGMA_MPS2 = 0.1, 1e-6


class Drift(Protocol):
    """States (n,) whose first two are the error of the position, north and east, m."""

    def start(self, sigma_m: float, course_rad: float) -> FloatArray:
        """(n, n) covariance at the start for a 1-sigma of the position per axis."""
        ...

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Transition and covariance of the process noise, (n, n) each, over a time with courses (T,), ends included."""
        ...

    def velocity(self, course_rad: float) -> FloatArray:
        """(2, n): what the states say of the velocity's error that lasts, north and east, m/s."""
        ...

    def acceleration(self, course_rad: float) -> FloatArray:
        """(2, n) of the acceleration's error, m/s²."""
        ...

    def jerk(self, course_rad: float) -> FloatArray:
        """(2, n) of its rate, m/s³."""
        ...

    def bend_m(self, span_s: float) -> float:
        """1-sigma by which the process noise bends the track over a time, per axis, beyond the states at its end."""
        ...

    def noise_m(self, span_s: float) -> float:
        """1-sigma of what wanders quickly along it."""
        ...


class Inertial:
    """States (10,): position, velocity, acceleration, accelerometer bias, gyroscope drift x gravity."""

    def start(self, sigma_m: float, course_rad: float) -> FloatArray:
        """What is known at the start, and what the sensors are stated to err by."""
        each = (sigma_m, START_SIGMA_MPS, START_SIGMA_MPS2, facts.ACCELEROMETER, facts.GRAVITY * facts.GYROSCOPE)
        return np.diag(np.repeat(np.square(each), 2))

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By the error equations."""
        A = np.zeros((10, 10))
        A[:2, 2:4] = A[2:4, 4:6] = np.eye(2)
        A[4:6, 6:8] = (turned(course_rad[-1]) - turned(course_rad[0])) / dt_s
        A[4:6, 8:10] = np.mean([turned(c) for c in course_rad], axis=0)
        A[4:6, 2:4] = -facts.GRAVITY / facts.EARTH_M * np.eye(2)
        walk = facts.GRAVITY * facts.ANGLE_WALK
        return discrete(A, np.array([0, 0, *[facts.VELOCITY_WALK**2] * 2, *[walk**2] * 2, 0, 0, 0, 0]), dt_s)

    def velocity(self, course_rad: float) -> FloatArray:
        """Of the velocity."""
        return np.eye(10)[2:4]

    def acceleration(self, course_rad: float) -> FloatArray:
        """Of the acceleration."""
        return np.eye(10)[4:6]

    def jerk(self, course_rad: float) -> FloatArray:
        """Of its rate."""
        schuler = -facts.GRAVITY / facts.EARTH_M * np.eye(2)
        return np.hstack([np.zeros((2, 2)), schuler, np.zeros((2, 4)), turned(course_rad)])

    def bend_m(self, span_s: float) -> float:
        """Of what walks at random."""
        return facts.GRAVITY * facts.ANGLE_WALK * math.sqrt(span_s**5 / 20)

    def noise_m(self, span_s: float) -> float:
        """Of the quick noise."""
        return 0.0


class Odometry:
    """States (6,): position, noise of the velocity, scale error x speed, heading error x speed."""

    def __init__(self, heading_rad: float) -> None:
        self.sigma = np.array([*[facts.ODOMETRY_MPS] * 2, facts.SCALE * facts.SPEED_MPS, heading_rad * facts.SPEED_MPS])
        self.lasts_s = np.array([*[facts.ODOMETRY_S] * 2, facts.SCALE_S, facts.HEADING_S])

    def start(self, sigma_m: float, course_rad: float) -> FloatArray:
        """What is known at the start, and what the sensors are stated to err by."""
        return np.diag([*[sigma_m**2] * 2, *np.square(self.sigma)])

    def over(self, dt_s: float, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By the error equations."""
        A = np.zeros((6, 6))
        A[:2, 2:4], A[:2, 4:6] = np.eye(2), np.mean([turned(c) for c in course_rad], axis=0)
        A[2:, 2:] = -np.diag(1 / self.lasts_s)
        return discrete(A, np.array([0, 0, *(2 * np.square(self.sigma) / self.lasts_s)]), dt_s)

    def velocity(self, course_rad: float) -> FloatArray:
        """Of the velocity."""
        return np.hstack([np.zeros((2, 4)), turned(course_rad)])

    def acceleration(self, course_rad: float) -> FloatArray:
        """Of the acceleration."""
        return np.zeros((2, 6))

    def jerk(self, course_rad: float) -> FloatArray:
        """Of its rate."""
        return np.zeros((2, 6))

    def bend_m(self, span_s: float) -> float:
        """Of what walks at random."""
        walk = float(np.max(self.sigma[2:] * np.sqrt(2 / self.lasts_s[2:])))
        return walk * span_s**1.5 / math.sqrt(3)

    def noise_m(self, span_s: float) -> float:
        """Of the quick noise."""
        return facts.ODOMETRY_MPS * math.sqrt(2 * facts.ODOMETRY_S * span_s)


def drift_of(model: DriftModel) -> Drift:
    """The states of a dead reckoning."""
    return Inertial() if model.inertial else Odometry(model.heading_rad)


def turned(course_rad: float) -> FloatArray:
    """(2, 2) from forward, right to north, east."""
    c, s = math.cos(course_rad), math.sin(course_rad)
    return np.array([[c, -s], [s, c]])


def discrete(A: FloatArray, density: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Transition and covariance, (n, n) each, of dx/dt = A x + white noise of (n,) densities over a time (Van Loan, IEEE Trans.
    Autom. Control 23, 1978)."""
    n = len(A)
    both = expm(np.block([[-A, np.diag(density)], [np.zeros((n, n)), A.T]]) * dt_s)
    F = both[n:, n:].T
    Q = F @ both[:n, n:]
    return np.asarray(F, dtype=np.float64), np.asarray((Q + Q.T) / 2, dtype=np.float64)
