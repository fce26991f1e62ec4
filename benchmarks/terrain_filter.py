"""The error-state Kalman filter of the simulated flight: errors of dead reckoning and of the barometer.

State (7,): error of position (m), velocity (m/s) and acceleration (m/s^2) to the north and east, and of the height (m); each is
what the dead reckoning says minus the truth. Inertial: the acceleration error (tilt and accelerometer bias) walks, and a turn
sets the accelerometers' bias free. Odometry: the velocity error is first-order Gauss-Markov and turns with the vehicle.

The barometer walks a metre over a stretch, so a fix tells its error in the middle of the stretch: the update is of that state
(the walk since is subtracted from its variance), and what it says of the error now follows by their covariance. `then` is that
state after the update, with its variance: the height with a lag of half a stretch.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks import terrain_flight as facts
from benchmarks.terrain_flight import DriftModel
from visloc_companion.core import kalman
from visloc_companion.localise.terrain.base import TerrainFix
from visloc_companion.types import Accepted, FloatArray, Rejected

H = np.zeros((3, 8))
H[0, 0] = H[1, 1] = H[2, 7] = 1.0
WALK_M2PS = 2 * facts.BARO_M**2 / facts.BARO_S
GATE_SIGMA = 5.0
START_SIGMA_H_M = 10.0
TURN = 2.0
"""The parts of a turn free the same bias: their sum is more than that of independent parts."""


class ErrorFilter:
    """Mean `x` (7,) and covariance `P` (7, 7) of the dead reckoning's errors."""

    def __init__(self, drift: DriftModel, sigma_m: float) -> None:
        self.drift = drift
        speed = 0.1 if drift.inertial else math.hypot(facts.SCALE, drift.heading_rad) * facts.SPEED_MPS
        acceleration = 1e-3 if drift.inertial else 1e-6
        self.sigma_v_mps = speed
        self.then = 0.0, START_SIGMA_H_M**2
        self.x: FloatArray = np.zeros(7)
        self.P: FloatArray = np.diag([sigma_m**2] * 2 + [speed**2] * 2 + [acceleration**2] * 2 + [START_SIGMA_H_M**2])

    def carry(self, dt_s: float, turned_rad: float) -> None:
        """Over a time in which the vehicle turned by an angle."""
        eye = np.eye(2)
        F, Q = np.eye(7), np.zeros((7, 7))
        if self.drift.inertial:
            F[:2, 2:4], F[:2, 4:6], F[2:4, 4:6] = dt_s * eye, dt_s**2 / 2 * eye, dt_s * eye
            q = (facts.GRAVITY * facts.ANGLE_WALK) ** 2 + (facts.GRAVITY * facts.GYROSCOPE) ** 2 * 100.0
            b = np.array([dt_s**3 / 6, dt_s**2 / 2, dt_s])
            for axis in (0, 1):
                at = np.ix_([axis, 2 + axis, 4 + axis], [axis, 2 + axis, 4 + axis])
                Q[at] += q * np.outer(b, b) / dt_s + np.diag([0.0, facts.VELOCITY_WALK**2 * dt_s, 1e-12])
            freed = TURN * 2 * abs(math.sin(min(turned_rad, math.pi) / 2)) * facts.ACCELEROMETER
            Q[:2, :2] += eye * (freed * dt_s**2 / 4) ** 2
            Q[2:4, 2:4] += eye * (freed * dt_s / 2) ** 2
            Q[4:6, 4:6] += eye * freed**2
        else:
            a = math.exp(-dt_s / facts.SCALE_S) * math.cos(min(turned_rad, math.pi / 2))
            F[:2, 2:4], F[2:4, 2:4] = dt_s * (1 + a) / 2 * eye, a * eye
            kept = (1 - a * a) * self.sigma_v_mps**2
            white = 2 * facts.ODOMETRY_MPS**2 * facts.ODOMETRY_S * dt_s
            Q[:2, :2] += eye * (white + kept * dt_s**2 / 3)
            Q[2:4, 2:4] += eye * kept
            Q[:2, 2:4] += eye * kept * dt_s / 2
            Q[2:4, :2] += eye * kept * dt_s / 2
            Q[4:6, 4:6] += 1e-12 * eye
        Q[6, 6] = WALK_M2PS * dt_s
        self.x, self.P = kalman.predict(self.x, self.P, F, Q, np.zeros(7))

    def doubt(self) -> None:
        """Something well seen contradicts the filter: its uncertainty doubles, so that the search reaches as far."""
        self.P = self.P * 4.0

    def observe(
        self, fix: TerrainFix, p_dead_reckoned_m: FloatArray, h_indicated_m: float, common_m: float
    ) -> Accepted | Rejected:
        """Take a fix at the time that the filter stands at; `common_m` is the part of its 1-sigma that all fixes share, which the
        states do not hold."""
        R = np.zeros((3, 3))
        R[:2, :2], R[2, 2] = np.array(fix.cov_ne_m2) - np.eye(2) * common_m**2, fix.sigma_h_then_m**2
        z = np.array([*(p_dead_reckoned_m - np.array(fix.p_ne_m)), h_indicated_m - fix.h_amsl_m])
        x, P = np.append(self.x, self.x[6]), np.zeros((8, 8))
        P[:7, :7] = self.P
        P[7], P[:, 7] = P[6], P[6]
        P[6, 7] = P[7, 6] = P[7, 7] = max(float(P[6, 6]) - WALK_M2PS * fix.height_age_s, 1e-6)
        got = kalman.update(x, P, z, R, H, gate_sigma=GATE_SIGMA)
        if isinstance(got, Rejected):
            self.then = float(x[7]), float(P[7, 7])
            return got
        self.x, self.P, self.then = got.x[:7], got.P[:7, :7], (float(got.x[7]), float(got.P[7, 7]))
        return Accepted(got.nis)
