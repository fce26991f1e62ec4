"""The error-state Kalman filter of the simulated flight: errors of dead reckoning and of the barometer.

States: those of the dead reckoning (benchmarks/terrain_drift.py; what it says minus the truth), then the barometer's error (m).

A stretch is put together by dead reckoning, so that a fix errs by what the filter does not know of its own velocity and
acceleration (`TerrainFix.by_drift`): fed as an error of its own, it would be counted as news of what it came from. The
measurement is of these states, too, and its noise is what the terrain alone leaves.

The barometer walks a metre over a stretch, so a fix tells its error in the middle of the stretch: the update is of that state
(the walk since is subtracted from its variance), and what it says of the error now follows by their covariance. `then` is that
state after the update, with its variance: the height with a lag of half a stretch.
"""

from __future__ import annotations

import numpy as np

from benchmarks import terrain_flight as facts
from benchmarks.terrain_drift import drift_of
from benchmarks.terrain_flight import DriftModel
from visloc_companion.core import kalman
from visloc_companion.localise.terrain.base import TerrainFix
from visloc_companion.types import Accepted, FloatArray, Rejected

WALK_M2PS = 2 * facts.BARO_M**2 / facts.BARO_S
GATE_SIGMA = 5.0
START_SIGMA_H_M = 10.0


class ErrorFilter:
    """Mean `x` (n,) and covariance `P` (n, n) of the dead reckoning's errors, the barometer's last."""

    def __init__(self, model: DriftModel, sigma_m: float, course_rad: float) -> None:
        self.drift, self.course_rad = drift_of(model), course_rad
        of_drift = self.drift.start(sigma_m, course_rad)
        self.n = len(of_drift) + 1
        self.then = 0.0, START_SIGMA_H_M**2
        self.x: FloatArray = np.zeros(self.n)
        self.P: FloatArray = np.zeros((self.n, self.n))
        self.P[:-1, :-1], self.P[-1, -1] = of_drift, START_SIGMA_H_M**2

    def carry(self, dt_s: float, course_rad: FloatArray) -> None:
        """Over a time with courses (T,), evenly spaced, the last of them that of its end."""
        F, Q = np.eye(self.n), np.zeros((self.n, self.n))
        F[:-1, :-1], Q[:-1, :-1] = self.drift.over(dt_s, np.append(self.course_rad, course_rad))
        Q[-1, -1] = WALK_M2PS * dt_s
        self.x, self.P = kalman.predict(self.x, self.P, F, Q, np.zeros(self.n))
        self.course_rad = float(course_rad[-1])

    def motion(self) -> tuple[FloatArray, FloatArray]:
        """Errors of velocity, acceleration and its rate, (6,) north and east each, with covariance (6, 6)."""
        M = np.zeros((6, self.n))
        M[:, :-1] = np.vstack([rows(self.course_rad) for rows in (self.drift.velocity, self.drift.acceleration, self.drift.jerk)])
        return M @ self.x, M @ self.P @ M.T

    def doubt(self) -> None:
        """Something well seen contradicts the filter: its uncertainty doubles, so that the search reaches as far."""
        self.P = self.P * 4.0

    def observe(
        self, fix: TerrainFix, p_dead_reckoned_m: FloatArray, h_indicated_m: float, own_cov_m2: FloatArray
    ) -> Accepted | Rejected:
        """Take a fix at the time that the filter stands at. `own_cov_m2` (2, 2) is its covariance without what all fixes share,
        which the states do not hold, and without what the drift leaves, which they do."""
        H, R = np.zeros((3, self.n + 1)), np.zeros((3, 3))
        H[0, 0] = H[1, 1] = H[2, self.n] = 1.0
        rows = np.vstack([self.drift.velocity(self.course_rad), self.drift.acceleration(self.course_rad)])
        H[:2, : self.n - 1] -= np.array(fix.by_drift) @ rows
        R[:2, :2], R[2, 2] = own_cov_m2, fix.sigma_h_then_m**2
        z = np.array([*(p_dead_reckoned_m - np.array(fix.p_ne_m)), h_indicated_m - fix.h_amsl_m])
        # the fix was made of soundings that the mean had moved: what it says is of the errors beyond the mean
        z[:2] += H[:2, 2 : self.n] @ self.x[2:]
        h = self.n - 1
        x, P = np.append(self.x, self.x[h]), np.zeros((self.n + 1, self.n + 1))
        P[: self.n, : self.n] = self.P
        P[self.n], P[:, self.n] = P[h], P[h]
        P[h, self.n] = P[self.n, h] = P[self.n, self.n] = max(
            float(P[h, h]) - WALK_M2PS * max(fix.height_age_s, facts.STEP_S), 1e-6
        )
        got = kalman.update(x, P, z, R, H, gate_sigma=GATE_SIGMA)
        if isinstance(got, Rejected):
            self.then = float(x[self.n]), float(P[self.n, self.n])
            return got
        self.x, self.P = got.x[: self.n], got.P[: self.n, : self.n]
        self.then = float(got.x[self.n]), float(got.P[self.n, self.n])
        return Accepted(got.nis)
