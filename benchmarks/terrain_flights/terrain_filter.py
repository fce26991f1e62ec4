"""The error-state Kalman filter of the simulated flight: errors of dead reckoning and of the height.

States: those of the dead reckoning (benchmarks/terrain_flights/terrain_drift.py; what it says minus the truth), then those of the
height (benchmarks/terrain_flights/terrain_vertical.py).

A stretch is put together by dead reckoning, so that a fix errs by what the filter does not know of its own velocity and
acceleration (`TerrainFix.by_drift`): fed as an error of its own, it would be counted as news of what it came from. The
measurement is of these states, too, and its noise is what the terrain alone leaves.

A fix tells the height's error in the middle of the stretch, and what it says of the error now follows by their covariance.
`then` is the error at that time after the update, with its variance: the height with a lag of half a stretch.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from benchmarks.terrain_flights import terrain_flight as facts
from benchmarks.terrain_flights.terrain_drift import drift_of
from benchmarks.terrain_flights.terrain_flight import DriftModel
from benchmarks.terrain_flights.terrain_vertical import START_SIGMA_H_M, Carried, vertical_of
from visloc_companion.core import kalman
from visloc_companion.localise.terrain.base import TerrainFix
from visloc_companion.types import Accepted, FloatArray, Rejected

GATE_SIGMA = 5.0
REMEMBERED = 400
"""Steps that it was carried over, of a second and more, through which a stretch is looked back."""
BAROMETER_SAMPLES = 10
"""So many of the barometer's samples are taken together, where it is measured beside the height."""


class ErrorFilter:
    """Mean `x` (n,) and covariance `P` (n, n) of the errors of dead reckoning and, from `h` on, of the height."""

    def __init__(self, model: DriftModel, sigma_m: float, course_rad: float) -> None:
        self.drift, self.vertical = drift_of(model), vertical_of(model)
        self.course_rad = course_rad
        self.past: deque[Carried] = deque(maxlen=REMEMBERED)
        of_drift = self.drift.start(sigma_m, course_rad)
        self.h = len(of_drift)
        self.n = self.h + self.vertical.n
        self.then = 0.0, START_SIGMA_H_M**2
        self.x: FloatArray = np.zeros(self.n)
        self.P: FloatArray = np.zeros((self.n, self.n))
        self.P[: self.h, : self.h], self.P[self.h :, self.h :] = of_drift, self.vertical.start()

    def carry(self, course_rad: FloatArray, above_barometer_m: FloatArray) -> None:
        """Over T steps with the courses (T,) at their ends and, there, the reckoned height above the barometer's (T,)."""
        together = BAROMETER_SAMPLES if self.vertical.beside_barometer else len(course_rad)
        for first in range(0, len(course_rad), together):
            part = slice(first, first + together)
            self._predict(course_rad[part])
            self._measure_barometer(above_barometer_m[part])

    def _predict(self, course_rad: FloatArray) -> None:
        flown, dt_s = np.append(self.course_rad, course_rad), len(course_rad) * facts.STEP_S
        F, Q = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        of_drift, of_height = slice(None, self.h), slice(self.h, None)
        for which, states in ((of_drift, self.drift), (of_height, self.vertical)):
            F[which, which], Q[which, which] = states.over(dt_s, flown)
        self.x, self.P = kalman.predict(self.x, self.P, F, Q, np.zeros(self.n))
        self.course_rad = float(flown[-1])
        self.past.append(Carried(dt_s, flown, F[of_height, of_height]))

    def _measure_barometer(self, above_m: FloatArray) -> None:
        row = self.vertical.barometer(self.past[-1])
        if row is None:
            return
        H = np.append(np.zeros(self.h), row)[None]
        R = np.array([[facts.BARO_NOISE_M**2 / len(above_m)]])
        got = kalman.update(self.x, self.P, np.array([above_m.mean()]), R, H)
        if not isinstance(got, Rejected):
            self.x, self.P = got.x, got.P

    def height(self) -> tuple[float, float]:
        """The height's error and its variance, m²."""
        return float(self.x[self.h]), float(self.P[self.h, self.h])

    def recall(self, age_s: float) -> None:
        """`then` is the height's error at an age, by what is known now."""
        x, P, _, then = self.vertical.lagged(self.x, self.P, age_s, self.past)
        self.then = float(then @ x), float(then @ P @ then)

    def height_since(self, age_s: FloatArray) -> FloatArray:
        """(N,) by how much the height's error was more at (N,) ages than it is now; negative ages are to come."""
        return np.asarray(self.vertical.since(age_s, self.past) @ self.x[self.h :], dtype=np.float64)

    def height_walk(self, span_s: float) -> float:
        """What a prior says of the height over a stretch (TerrainPrior.sigma_h_walk)."""
        return self.vertical.walk(self.P[self.h :, self.h :], span_s, self.past)

    def motion(self) -> tuple[FloatArray, FloatArray]:
        """Errors of velocity, acceleration and its rate, (6,) north and east each, with covariance (6, 6)."""
        M = np.zeros((6, self.n))
        rows = (self.drift.velocity, self.drift.acceleration, self.drift.jerk)
        M[:, : self.h] = np.vstack([of(self.course_rad) for of in rows])
        return M @ self.x, M @ self.P @ M.T

    def doubt(self) -> None:
        """Something well seen contradicts the filter: its uncertainty doubles, so that the search reaches as far."""
        self.P = self.P * 4.0

    def observe(
        self, fix: TerrainFix, p_dead_reckoned_m: FloatArray, h_reckoned_m: float, own_cov_m2: FloatArray
    ) -> Accepted | Rejected:
        """Take a fix at the time that the filter stands at. `own_cov_m2` (2, 2) is its covariance without what all fixes share,
        which the states do not hold, and without what the drift leaves, which they do."""
        x, P, told, then = self.vertical.lagged(self.x, self.P, fix.height_age_s, self.past)
        H, R = np.zeros((3, len(x))), np.zeros((3, 3))
        H[0, 0] = H[1, 1] = 1.0
        H[2] = told
        rows = np.vstack([self.drift.velocity(self.course_rad), self.drift.acceleration(self.course_rad)])
        H[:2, : self.h] -= np.array(fix.by_drift) @ rows
        R[:2, :2], R[2, 2] = own_cov_m2, fix.sigma_h_then_m**2
        z = np.array([*(p_dead_reckoned_m - np.array(fix.p_ne_m)), h_reckoned_m - fix.h_amsl_m])
        # the fix was made of soundings that the mean had moved: what it says is of the errors beyond the mean
        z[:2] += H[:2, 2 : self.h] @ x[2 : self.h]
        z[2] += float(told @ x) - x[self.h]
        got = kalman.update(x, P, z, R, H, gate_sigma=GATE_SIGMA)
        if not isinstance(got, Rejected):
            x, P = got.x, got.P
            self.x, self.P = x[: self.n], P[: self.n, : self.n]
        self.then = float(then @ x), float(then @ P @ then)
        return got if isinstance(got, Rejected) else Accepted(got.nis)
