"""A plane's pitot tube: its velocity through the air, along the heading.

While the velocity is known a Kalman filter learns wind and the tube's scale (autopilots correct it, ARSPD_RATIO; what they stream
is not corrected): what is measured = scale x velocity - drift, where the drift is scale x wind. Courses must differ for both to
be told apart; where they did not, another course is doubted (air_velocity.py). So is a heading that is off: 2 degrees of it look
like 0.9 m/s of wind on one course, and like as much the other way on the opposite one. It is considered, not learned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.filter.propagation import HEADING, SLOW, WIND_WALK_MPS_PER_SQRT_S
from visloc_companion.core.velocity.air_residuals import Residuals
from visloc_companion.core.velocity.air_velocity import AirVelocity
from visloc_companion.types import FloatArray, Rejected, Vec2, Vec3

LEAST_MPS = 8.0
"""Below it a pitot tube measures little, and a vehicle hovers."""
GAS_CONSTANT, SEA_LEVEL_K, SEA_LEVEL_HPA, LAPSE_EXPONENT = 287.053, 288.15, 1013.25, 0.190263
HEADING_SIGMA_RAD, HEADING_TAU_S = next((sigma, tau_s) for state, sigma, tau_s in SLOW if state == HEADING)
START_SIGMA: FloatArray = np.array([0.1, 10.0, 10.0, HEADING_SIGMA_RAD])
WALK_PER_SQRT_S: FloatArray = np.array([0.001, *[WIND_WALK_MPS_PER_SQRT_S] * 2, HEADING_SIGMA_RAD * math.sqrt(2 / HEADING_TAU_S)])
START_NOISE_MPS, LEAST_NOISE_MPS = 1.0, 0.2
"""Gusts, sideslip."""
N_CONSIDERED = 1
ENOUGH, LEAST_SCALE = 20, 0.3
GATE_SIGMA = 5.0


@dataclass(frozen=True, slots=True)
class Airspeed:
    """Velocity through the air as measured, north and east m/s."""

    t_boot_ns: int
    v_ne_mps: Vec2


def true_airspeed_mps(static_hpa: float, dynamic_hpa: float) -> float:
    """Of an incompressible flow in the standard atmosphere (ICAO Doc 7488): the autopilot's own temperature is its board's."""
    if static_hpa <= 0 or dynamic_hpa <= 0:
        return 0.0
    kelvin = SEA_LEVEL_K * (static_hpa / SEA_LEVEL_HPA) ** LAPSE_EXPONENT
    return math.sqrt(2 * dynamic_hpa / static_hpa * GAS_CONSTANT * kelvin)


class PitotLearner:
    """`learn` beside a velocity that is known; `velocity` without one.

    State: scale, drift north and east (m/s), error of the heading (rad, clockwise), which stays at zero.
    """

    def __init__(self) -> None:
        self._x, self._P = np.array([1.0, 0.0, 0.0, 0.0]), np.diag(START_SIGMA**2)
        self._residuals = Residuals(START_NOISE_MPS, LEAST_NOISE_MPS)
        self._J: FloatArray | None = None

    @property
    def known(self) -> bool:
        """Whether enough was learned."""
        return self._residuals.n >= ENOUGH and bool(self._x[0] >= LEAST_SCALE)

    def filter_restarted(self) -> None:
        """The position filter knows nothing of lasting errors any more."""
        self._J = None

    def learn(self, air: Airspeed, v_ned_mps: Vec3, cov_ne_m2ps2: FloatArray) -> None:
        """Take a velocity through the air beside the velocity of its time with the covariance of its error (2, 2)."""
        self._J = None
        north, east, _ = v_ned_mps
        air_north, air_east = air.v_ne_mps
        H, of_velocity = np.array([[north, -1.0, 0.0, -air_east], [east, 0.0, -1.0, air_north]]), self._x[0] ** 2 * cov_ne_m2ps2
        P = self._later(self._residuals.since_s(air.t_boot_ns))
        R, measured = self._residuals.variance * np.eye(2) + of_velocity, np.array(air.v_ne_mps)
        got = kalman.update(
            self._x, P, measured, R, H, gate_sigma=GATE_SIGMA if self.known else math.inf, n_considered=N_CONSIDERED
        )
        if isinstance(got, Rejected):
            self._P = P
            return
        self._residuals.take(air.t_boot_ns, measured - H @ self._x, float(np.trace(H @ P @ H.T + of_velocity)) / 2)
        self._x, self._P = got.x, got.P

    def _later(self, dt_s: float) -> FloatArray:
        """The covariance (4, 4) after a while."""
        F = np.diag([1.0, 1.0, 1.0, math.exp(-dt_s / HEADING_TAU_S)])
        return np.asarray(F @ self._P @ F + np.diag(WALK_PER_SQRT_S**2 * dt_s))

    def velocity(self, air: Airspeed) -> AirVelocity | None:
        """The velocity at a time; None where too little is known."""
        if not self.known:
            return None
        scale = float(self._x[0])
        air_north, air_east = air.v_ne_mps
        north, east = ((np.array(air.v_ne_mps) + self._x[1:3]) / scale).tolist()
        J = np.array([[-north, 1.0, 0.0, air_east], [-east, 0.0, 1.0, -air_north]]) / scale
        before, self._J = self._J, J
        doubt = None if before is None else (J - before) @ self._P @ (J - before).T
        turning = (-air_east / scale, air_north / scale)
        noise = self._residuals.variance / scale**2 * np.eye(2)
        return AirVelocity(air.t_boot_ns, (north, east), noise, J @ self._P @ J.T, doubt, turning)
