"""How the filter's state goes on between measurements, for each velocity that can drive it.

State (17,), pairs north and east: position at the EKF origin (m), what neighbouring fixes get wrong in common (1-sigmas of that
part of their claim: lasting.py), what the camera's mounting has of that, ahead and to the right (1-sigmas likewise), error of the
driving velocity (its value minus the true one, m/s), error of the acceleration
that an inertial velocity is integrated from (m/s²), lasting error of the velocity that the air tells (wind, m/s:
air_velocity.py); then the error of the heading by which those accelerations were turned (rad, clockwise), and what odometry gets
wrong in scale (a share), in heading (rad), and by a lens that is longer than calibrated (a share of the focal length); last the
same share as fixes have it. It is one lens, but a rolling shutter and a clock that is off look like another one while the camera
turns, so odometry does not teach it to fixes, and fixes learn it beside a GNSS that is trusted, or not at all (fusion.py).

* `AUTOPILOT`, `FED_BACK`: the autopilot's velocity; its error is first-order Gauss-Markov.
* `INERTIAL`: accelerations turned by the attitude and integrated (inertial.py). The error of that velocity is the integral of the
  acceleration's error (biases, tilt; first-order Gauss-Markov: Singer's model, 1970, without its manoeuvres), of white noise, and
  of the true acceleration turned by the heading's error.

Closed form for the first (Brown & Hwang, section 5.3); for the second a Gauss-Legendre quadrature, exact to rounding for steps
short against `acceleration_correlation_s`.
"""

from __future__ import annotations

import math
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.types import FloatArray, Vec2

N_STATES = 17
POSITION, LASTING, MOUNTING, VELOCITY, ACCELERATION, AIR = (slice(k, k + 2) for k in range(0, 12, 2))
HEADING, ODOMETRY_SCALE, ODOMETRY_HEADING, ODOMETRY_LENS, FIX_LENS = 12, 13, 14, 15, 16
LASTS = slice(LASTING.start, MOUNTING.stop)
"""What lasts of a fix."""
PAIRS = np.array([pair.start for pair in (POSITION, VELOCITY, ACCELERATION, AIR)])
AXES = tuple((N_STATES * (PAIRS + axis)[:, None] + PAIRS + axis).ravel() for axis in range(2))
"""Where PAIRS of each axis stand in a matrix (17, 17) row by row."""
H_POSITION: FloatArray = np.eye(N_STATES)[POSITION]
N_CONSIDERED = N_STATES - VELOCITY.start
"""States that stay as they are where the velocity descends from our own fixes."""
WALK_M_PER_SQRT_S = 0.05
"""Random walk of the integration itself (time stamps, rounding of the velocity messages)."""
INERTIAL_WALK_MPS_PER_SQRT_S = 0.12
"""Noise of the accelerometers, with what vibration aliases into samples of 50 Hz."""
WIND_WALK_MPS_PER_SQRT_S = 0.1
UNAIDED_GAP_S = 1.0
"""Longer without a velocity the link is silent: nothing is known of what the vehicle did meanwhile."""
OVERDUE_S = 0.25
"""So long after its sample, 2.5 intervals of `link.position_rate_hz`, a held velocity claims that the vehicle turns."""
AIR_SIGMA_MPS = 10.0
"""1-sigma of that velocity's error before anything is known of it."""
ODOMETRY_SCALE_SIGMA, ODOMETRY_HEADING_SIGMA_RAD, ODOMETRY_LENS_SIGMA = 0.02, math.radians(1.0), FOCAL_SHARE
FIX_LENS_SIGMA = 0.01
"""With more, fixes of a camera that leans count for too little, and a rolling shutter shows."""
SLOW = (
    (HEADING, math.radians(2.0), 100.0),
    (ODOMETRY_SCALE, ODOMETRY_SCALE_SIGMA, 60.0),
    (ODOMETRY_HEADING, ODOMETRY_HEADING_SIGMA_RAD, 60.0),
    (ODOMETRY_LENS, ODOMETRY_LENS_SIGMA, 600.0),
    (FIX_LENS, FIX_LENS_SIGMA, 600.0),
)
"""States that wander about zero on their own: which, 1-sigma, correlation time in seconds."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
SERIES_BELOW = 0.01


class Drive(Enum):
    """Which velocity drives the filter: the autopilot's own, while GNSS that is trusted holds it; the same while it descends from
    what we inject; one integrated from accelerations, which we feed through the attitude alone; or none, little known."""

    AUTOPILOT = "autopilot"
    FED_BACK = "fed_back"
    INERTIAL = "inertial"
    NONE = "none"


def initial_covariance(position_m: float, velocity_mps: float, acceleration_mps2: float) -> FloatArray:
    """(17, 17) where position and the errors of velocity and acceleration have these 1-sigmas, and the air tells nothing yet."""
    pairs = np.repeat((position_m, 1.0, 1.0, velocity_mps, acceleration_mps2, AIR_SIGMA_MPS), 2)
    return np.diag(np.square([*pairs, *(sigma for _, sigma, _ in SLOW)]))


class Step(NamedTuple):
    """x -> F x and P -> F P F' + Q + s^2 V for a velocity whose error has the 1-sigma s; all (17, 17). V is of position and
    velocity alone and the same on both axes. `own` (3, 3) carries on what a solution has of it: variance of the position,
    covariance with the velocity, variance of the velocity; `own_more` (3, 1) is what a larger s^2 adds to these."""

    F: FloatArray
    Q: FloatArray
    V: FloatArray
    own: FloatArray
    own_more: FloatArray


def step(
    dt_s: float,
    drive: Drive,
    sigma_a_mps2: float,
    change_ne_mps: Vec2,
    settings: NavigatorSettings,
    gone_by: float = 0.0,
    lens_share: float = 0.0,
) -> Step:
    """How the state goes on over a time.

    `change_ne_mps`: by how much the driving velocity changes meanwhile. `gone_by`: the way, over that after which fixes look at
    other ground. `lens_share`: 1-sigma of the focal length beside what is believed of every lens.
    """
    bias = (sigma_a_mps2, settings.acceleration_correlation_s)
    inertial = drive is Drive.INERTIAL
    known = _inertial(dt_s, *bias) if inertial else _gauss_markov(dt_s, settings.velocity_correlation_s, *bias)
    F, Q = known.F.copy(), known.Q.copy()
    if inertial:
        north, east = change_ne_mps
        F[VELOCITY, HEADING] = -east, north
        F[POSITION, HEADING] = east * dt_s / 2, -north * dt_s / 2
    _forget(F, Q, gone_by)
    if lens_share > 0:
        _doubt_lens(F, Q, lens_share)
    return Step(F, Q, known.V, known.own, known.own_more)


def _forget(F: FloatArray, Q: FloatArray, gone_by: float) -> None:
    """What fixes get wrong in common goes by with the way, in place."""
    kept = math.exp(-gone_by)
    north, east = LASTING.start, LASTING.stop - 1
    F[north, north] = F[east, east] = kept
    Q[north, north] = Q[east, east] = 1 - kept * kept


def _doubt_lens(F: FloatArray, Q: FloatArray, share: float) -> None:
    """A lens that is off by so much stays so, in place."""
    for state in (ODOMETRY_LENS, FIX_LENS):
        Q[state, state] += share**2 * (1 - F[state, state] ** 2)


def _wander(F: FloatArray, Q: FloatArray, dt_s: float) -> None:
    for state, sigma, tau_s in SLOW:
        kept = math.exp(-dt_s / tau_s)
        F[state, state], Q[state, state] = kept, sigma**2 * (1 - kept * kept)


@lru_cache(maxsize=256)
def _gauss_markov(dt_s: float, tau_s: float, sigma_a: float, tau_a_s: float) -> Step:
    a, kept = math.exp(-dt_s / tau_s), math.exp(-dt_s / tau_a_s)
    F, per_variance, rest = np.eye(len(PAIRS)), np.zeros((4, 4)), np.zeros((4, 4))
    F[0, 1], F[1, 1], F[2, 2] = -tau_s * (1 - a), a, kept
    per_variance[1, 1] = 1 - a * a
    per_variance[0, 1] = per_variance[1, 0] = -tau_s * (1 - a) ** 2
    per_variance[0, 0] = tau_s**2 * _integrated(dt_s / tau_s)
    rest[0, 0], rest[2, 2], rest[3, 3] = WALK_M_PER_SQRT_S**2 * dt_s, sigma_a**2 * (1 - kept * kept), _wind_m2ps2(dt_s)
    return _wandering(F, rest, per_variance, dt_s)


@lru_cache(maxsize=256)
def _inertial(dt_s: float, sigma_a: float, tau_a_s: float) -> Step:
    x, kept = dt_s / tau_a_s, math.exp(-dt_s / tau_a_s)
    F, Q = np.eye(4), np.zeros((4, 4))
    F[0, 1], F[0, 2] = -dt_s, -(tau_a_s**2) * float(_twice_integrated(np.array([x]))[0])
    F[1, 2], F[2, 2] = -tau_a_s * math.expm1(-x), kept
    s = (NODES + 1) / 2 * x
    response = np.stack([-(tau_a_s**2) * _twice_integrated(s), -tau_a_s * np.expm1(-s), np.exp(-s)])
    Q[:3, :3] = (response * (WEIGHTS * dt_s / 2 * 2 * sigma_a**2 / tau_a_s)) @ response.T
    noise = INERTIAL_WALK_MPS_PER_SQRT_S**2
    Q[:2, :2] += noise * np.array([[dt_s**3 / 3, -(dt_s**2) / 2], [-(dt_s**2) / 2, dt_s]])
    Q[0, 0] += WALK_M_PER_SQRT_S**2 * dt_s
    Q[3, 3] = _wind_m2ps2(dt_s)
    return _wandering(F, Q, np.zeros((4, 4)), dt_s)


def _wandering(F: FloatArray, Q: FloatArray, V: FloatArray, dt_s: float) -> Step:
    """Of PAIRS (4, 4) the whole, with the states that wander on their own."""
    own = _own(F[0, 1], F[1, 1], V)
    whole = Step(_both_axes(F), _both_axes(Q), _both_axes(V), own[:, :3], own[:, 3:])
    _wander(whole.F, whole.Q, dt_s)
    whole.F[MOUNTING, MOUNTING] = np.eye(2)
    return whole


def _own(f: float, a: float, V: FloatArray) -> FloatArray:
    """(3, 4) Step.own and Step.own_more where the position goes on by f of the velocity's error, of which a share `a` remains."""
    return np.array([[1.0, 2 * f, f * f, V[0, 0]], [0.0, a, a * f, V[0, 1]], [0.0, 0.0, a * a, V[1, 1]]])


def _wind_m2ps2(dt_s: float) -> float:
    return WIND_WALK_MPS_PER_SQRT_S**2 * dt_s


def _both_axes(block: FloatArray) -> FloatArray:
    both, flat = np.zeros(N_STATES * N_STATES), block.ravel()
    for axis in AXES:
        both[axis] = flat
    return both.reshape(N_STATES, N_STATES)


def _twice_integrated(x: FloatArray) -> FloatArray:
    """x - 1 + exp(-x), by its series where that cancels."""
    series = x**2 / 2 - x**3 / 6 + x**4 / 24 - x**5 / 120
    return np.asarray(np.where(x < SERIES_BELOW, series, x + np.expm1(-x)), dtype=np.float64)


def _integrated(spread: float) -> float:
    """2 s - 3 + 4 exp(-s) - exp(-2 s), by its series where that cancels."""
    if spread < SERIES_BELOW:
        return spread**3 * (2 / 3 - spread / 2 + 7 * spread**2 / 30)
    return 2 * spread - 3 + 4 * math.exp(-spread) - math.exp(-2 * spread)
