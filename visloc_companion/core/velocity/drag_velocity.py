"""A multicopter's drag, learned while its velocity is known, tells the velocity afterwards (model: rotor_drag.py).

An extended Kalman filter of drag factors, wind and the accelerometers' bias takes the mean force of each second beside the
velocity of that second. Later the force of a second tells a velocity. What that gets wrong lasts (wind, factors, bias), but for
gusts, and is something else on another course: see AirVelocity.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.filter.propagation import WIND_WALK_MPS_PER_SQRT_S
from visloc_companion.core.velocity.air_residuals import Residuals
from visloc_companion.core.velocity.air_velocity import AirVelocity
from visloc_companion.core.velocity.rotor_drag import BIAS, WIND, Felt, by_state, by_velocity, force_mps2, velocity_ne_mps
from visloc_companion.types import FloatArray, Rejected, Vec3

FACTORS_PER_S = (0.2, 0.45, 1.0)
"""Where k1 may begin; linearised about one that is far off, the filter takes drag for wind. The likeliest is kept."""
START_SIGMA: FloatArray = np.array([0.0, 0.01, 5.0, 5.0, 0.1, 0.1])
K1_SIGMA, START_K2_PER_M = 0.4, 0.01
"""1-sigma of k1 as a share of it, and where k2 begins."""
CHOSEN_AFTER = 60
BIAS_WALK_MPS2_PER_SQRT_S = 0.01
WALK_PER_SQRT_S: FloatArray = np.array([0.003, 0.0003, *[WIND_WALK_MPS_PER_SQRT_S] * 2, *[BIAS_WALK_MPS2_PER_SQRT_S] * 2])
"""A copter of 2014 shows no more wind in minutes (tests/replay/test_rotor_drag.py)."""
START_NOISE_MPS2, LEAST_NOISE_MPS2 = 0.3, 0.05
ENOUGH = 20
"""Seconds of flight before anything is said."""
LEAST_FACTOR_PER_S, SURE_SIGMA = 0.08, 3.0
"""A plane's wings hold it up with no force along forward or right that would grow with its speed."""
MOST_NOISE_MPS = 5.0
"""A force that scatters by more than this much drag is not that of the air. Simulated multicopters have 0.2 to 0.8 m/s; planes,
whose forces are those of their wings in turns, 30 and more: one seemed to have a drag, and its pitot tube went unheard."""
GATE_SIGMA, GATED_IN_A_ROW = 5.0, 10
"""So many seconds in a row beyond the gate: it is another vehicle now (a payload dropped), and all begins anew."""


class DragLearner:
    """`learn` beside a velocity that is known; `velocity` without one."""

    def __init__(self) -> None:
        self._among = _begun()

    @property
    def known(self) -> bool:
        """Whether the vehicle is one whose drag is felt, as a multicopter's is."""
        return self._best.known

    @property
    def _best(self) -> _Hypothesis:
        return max(self._among, key=lambda one: one.log_likelihood)

    def learn(self, felt: Felt, v_ned_mps: Vec3, cov_ne_m2ps2: FloatArray) -> None:
        """Take the force of a second, and the velocity of that second with the covariance of its error (2, 2)."""
        for one in self._among:
            one.learn(felt, v_ned_mps, cov_ne_m2ps2)
        if len(self._among) > 1 and self._best.n >= CHOSEN_AFTER:
            self._among = [self._best]
        if all(one.gated >= GATED_IN_A_ROW for one in self._among):
            self._among = _begun()

    def velocity(self, felt: Felt, v_ned_mps: Vec3) -> AirVelocity | None:
        """The velocity of a second, its part down taken for true; None where too little is known."""
        return self._best.velocity(felt, v_ned_mps)

    def filter_restarted(self) -> None:
        """The position filter knows nothing of lasting errors any more."""
        for one in self._among:
            one.filter_restarted()


class _Hypothesis:
    """The filter of drag that begins at one k1 (1/s)."""

    def __init__(self, k1_per_s: float) -> None:
        self._x = np.array([k1_per_s, START_K2_PER_M, 0.0, 0.0, 0.0, 0.0])
        self._P = np.diag(START_SIGMA**2)
        self._P[0, 0] = (K1_SIGMA * k1_per_s) ** 2
        self.log_likelihood = 0.0
        self._residuals = Residuals(START_NOISE_MPS2, LEAST_NOISE_MPS2)
        self.gated = 0
        self._J: tuple[int, FloatArray] | None = None

    @property
    def n(self) -> int:
        """Seconds learned from."""
        return self._residuals.n

    def filter_restarted(self) -> None:
        """The position filter knows nothing of lasting errors any more."""
        self._J = None

    def learn(self, felt: Felt, v_ned_mps: Vec3, cov_ne_m2ps2: FloatArray) -> None:
        """Take the force of a second, and the velocity of that second with the covariance of its error (2, 2)."""
        self._J = None
        P = self._later(self._residuals.since_s(felt.t_boot_ns))
        H = by_state(self._x, felt.axes_ned, v_ned_mps)
        residual = felt.force_mps2 - force_mps2(self._x, felt.axes_ned, v_ned_mps)
        slope = by_velocity(self._x, felt.axes_ned, v_ned_mps)
        of_velocity = slope @ cov_ne_m2ps2 @ slope.T
        R = self._residuals.variance * np.eye(2) + of_velocity
        got = kalman.update(self._x, P, H @ self._x + residual, R, H, gate_sigma=GATE_SIGMA if self.n >= ENOUGH else math.inf)
        if isinstance(got, Rejected):
            self.gated += 1
            self.log_likelihood -= GATE_SIGMA**2 / 2
            return
        self.gated = 0
        self.log_likelihood -= (got.nis + math.log(float(np.linalg.det(H @ P @ H.T + R)))) / 2
        self._residuals.take(felt.t_boot_ns, residual, float(np.trace(H @ P @ H.T + of_velocity)) / 2)
        self._x, self._P = got.x, got.P

    def _later(self, dt_s: float) -> FloatArray:
        """The covariance (6, 6) after a while in which nothing was learned."""
        return np.asarray(self._P + np.diag(WALK_PER_SQRT_S**2 * dt_s))

    @property
    def known(self) -> bool:
        """Whether the vehicle is one whose drag is felt, as a multicopter's is."""
        k1_per_s, noise_mps2 = self._x[0], math.sqrt(self._residuals.variance)
        sure = k1_per_s >= max(LEAST_FACTOR_PER_S, SURE_SIGMA * math.sqrt(self._P[0, 0]))
        return self.n >= ENOUGH and bool(sure and noise_mps2 <= MOST_NOISE_MPS * k1_per_s)

    def velocity(self, felt: Felt, v_ned_mps: Vec3) -> AirVelocity | None:
        """The velocity of a second, its part down taken for true; None where too little is known."""
        if not self.known:
            return None
        found = velocity_ne_mps(self._x, felt, v_ned_mps[2])
        if found is None:
            return None
        at = (*found, v_ned_mps[2])
        by_force = np.linalg.inv(by_velocity(self._x, felt.axes_ned, at))
        J = -by_force @ by_state(self._x, felt.axes_ned, at)
        P = self._later(self._residuals.age_s(felt.t_boot_ns))
        before, self._J = self._J, (felt.t_boot_ns, J)
        doubt = None
        if before is not None:
            other, since_s = J - before[1], (felt.t_boot_ns - before[0]) * 1e-9
            doubt = other @ P @ other.T + BIAS_WALK_MPS2_PER_SQRT_S**2 * since_s * J[:, BIAS] @ J[:, BIAS].T
        wind_north, wind_east = self._x[WIND].tolist()
        return AirVelocity(
            felt.t_boot_ns,
            found,
            self._residuals.variance * by_force @ by_force.T,
            J @ P @ J.T,
            doubt,
            (wind_east - found[1], found[0] - wind_north),
        )


def _begun() -> list[_Hypothesis]:
    return [_Hypothesis(k1) for k1 in FACTORS_PER_S]
