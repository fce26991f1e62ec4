"""A helicopter's flight of 218 km over a world, its dead reckoning with realistic errors, and what its range sensors measure.

Track: legs of the world's length joined by turns, 50 m/s, about 300 m above the smoothed ground. Dead reckoning, two models:

* `tactical`: two-axis inertial errors with the figures that Honeywell states for its HG1700 (accelerometer bias 1 mg, velocity
  random walk 0.065 ft/s/sqrt(h), gyroscope bias 1 deg/h, angular random walk 0.125 deg/sqrt(h)), levelled at the start, so that a
  turn sets the accelerometers' bias free; heading error 0.05 deg + 1 deg/h, roll and pitch 0.03 deg. Its third accelerometer,
  with the same figures, reckons the height between the barometer's; a bank brings in the one to the right. It feels gravity's
  anomalies, too: 42 mGal (root of Tscherning and Rapp's global 1795 mGal², 1974), alike over 20 km (first-order Gauss-Markov).
* `mems`: odometry with a MEMS attitude: scale error 1 % (visual odometry's drift is of that order), heading error 1 deg,
  noise 0.2 m/s over 10 s; roll and pitch 0.2 deg.

Barometer: bias 10 m over an hour (weather, temperature) and 0.3 m noise. Scanner: 120 beams over 90 degrees every 0.1 s, 0.3 m
noise; stereo would be 0.5 % of the height: 1.5 m. Altimeter: one beam down, 10 Hz, 0.5 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.terrain_flights.terrain_world import World
from visloc_companion.types import FloatArray

LENGTH_M = 218_000.0
SPEED_MPS = 50.0
STEP_S = 0.1
ABOVE_GROUND_M = 300.0
TURN_RADIUS_M = 1000.0
MARGIN_M = 4000.0
GRAVITY = 9.81
SCAN_S = 0.1
BEAMS = np.tan(np.deg2rad(np.linspace(-45, 45, 120)))


@dataclass(frozen=True, slots=True)
class DriftModel:
    """What a kind of dead reckoning has for errors, 1-sigma (module docstring)."""

    name: str
    inertial: bool
    heading_rad: float
    tilt_rad: float


DRIFTS = {
    "tactical": DriftModel("tactical", True, math.radians(0.05), math.radians(0.03)),
    "mems": DriftModel("mems", False, math.radians(1.0), math.radians(0.2)),
}
SCALE, SCALE_S, HEADING_S, ODOMETRY_MPS, ODOMETRY_S = 0.01, 300.0, 600.0, 0.2, 10.0
ACCELEROMETER, VELOCITY_WALK = 9.81e-3, 3.3e-4
TILT_S = 60.0
EARTH_M = 6.37e6
ANOMALY, ANOMALY_M = 4.2e-4, 20_000.0
GYROSCOPE, ANGLE_WALK = math.radians(1.0) / 3600, math.radians(0.125) / 60
BARO_M, BARO_S, BARO_NOISE_M = 10.0, 3600.0, 0.3


@dataclass(frozen=True, eq=False)
class Flight:
    """At every STEP_S: true place (T, 2) and height (T,), course (T,), and the dead reckoning's velocity error (T, 2), heading
    error (T,), tilt error (T, 2), indicated height (T,) by the barometer, and the height by which it reckons (T,): of an inertial
    unit by its vertical accelerometer alone, which drifts without bound, else the indicated one."""

    drift: DriftModel
    p_ne_m: FloatArray
    h_amsl_m: FloatArray
    course_rad: FloatArray
    velocity_error_mps: FloatArray
    heading_error_rad: FloatArray
    tilt_error_rad: FloatArray
    h_indicated_m: FloatArray
    h_reckoned_m: FloatArray


def make_flight(world: World, drift: DriftModel, seed: int) -> Flight:
    """The flight of a seed; the track is the world's, the errors are the seed's."""
    rng = np.random.default_rng([seed, 3])
    p = _track(world.size_m)
    course = np.unwrap(np.arctan2(np.gradient(p[:, 1]), np.gradient(p[:, 0])))
    ground = world.ground(p)
    height = _low_passed(ground, 60.0) + ABOVE_GROUND_M
    height = np.maximum(height, _low_passed(ground + 120.0, 20.0))
    n = len(p)
    if drift.inertial:
        bias = rng.normal(0, ACCELEROMETER, 2)
        velocity_error = _inertial(rng, course, bias)
        heading_error = rng.normal(0, drift.heading_rad) + rng.normal(0, GYROSCOPE) * STEP_S * np.arange(n)
    else:
        heading_error = _gauss_markov(rng, n, drift.heading_rad, HEADING_S)
        velocity_error = _odometry(rng, course, heading_error)
    tilt = np.column_stack([_gauss_markov(rng, n, drift.tilt_rad, TILT_S) for _ in range(2)])
    slow = _gauss_markov(rng, n, BARO_M, BARO_S)
    indicated = height + slow + rng.normal(0, BARO_NOISE_M, n)
    reckoned = indicated
    if drift.inertial:
        of_height = _vertical(np.random.default_rng([seed, 5]), course, float(bias[1]), tilt, slow)
        reckoned = height + of_height + indicated[0] - height[0]
    return Flight(drift, p, height, course, velocity_error, heading_error, tilt, indicated, reckoned)


def felt(course_rad: FloatArray) -> FloatArray:
    """(T, 4): by how much the accelerometers' bias down and to the right and a tilt to the north and to the east (rad) are felt
    upwards, m/s², along courses (T,) that are flown STEP_S apart in coordinated turns."""
    aside = SPEED_MPS * np.gradient(course_rad, STEP_S)
    bank = np.arctan2(aside, GRAVITY)
    return np.column_stack([np.cos(bank), np.sin(bank), -np.sin(course_rad) * aside, np.cos(course_rad) * aside])


def scan(
    world: World, flight: Flight, steps: NDArray[np.int64], rng: np.random.Generator, sigma_m: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """(N, 3) north, east, up of each point from where its beam left, in the dead reckoning's axes, and (N,) the step of each."""
    clearance = flight.h_amsl_m[steps] - world.ground(flight.p_ne_m[steps])
    aside = clearance[:, None] * BEAMS
    course = flight.course_rad[steps][:, None]
    level = np.stack([-np.sin(course) * aside, np.cos(course) * aside], -1)
    return _met(world, flight, np.repeat(steps, len(BEAMS)), level.reshape(-1, 2), rng, sigma_m)


def beam(
    world: World, flight: Flight, steps: NDArray[np.int64], rng: np.random.Generator, sigma_m: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """The same of one beam down."""
    return _met(world, flight, steps, np.zeros((len(steps), 2)), rng, sigma_m)


def _met(
    world: World, flight: Flight, step: NDArray[np.int64], level_m: FloatArray, rng: np.random.Generator, sigma_m: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    at = flight.p_ne_m[step] + level_m
    surface, back = world.surface(at, rng)
    up = surface - flight.h_amsl_m[step] + rng.normal(0, sigma_m, len(step))
    tilt = flight.tilt_error_rad[step]
    turn = flight.heading_error_rad[step]
    north = np.cos(turn) * level_m[:, 0] - np.sin(turn) * level_m[:, 1] + tilt[:, 0] * up
    east = np.sin(turn) * level_m[:, 0] + np.cos(turn) * level_m[:, 1] + tilt[:, 1] * up
    seen_up = up - tilt[:, 0] * level_m[:, 0] - tilt[:, 1] * level_m[:, 1]
    return np.column_stack([north, east, seen_up])[back], step[back]


def _track(size_m: tuple[float, float]) -> FloatArray:
    """Legs to the north and south, one beside the other, joined by half circles; round again where they do not suffice."""
    step = SPEED_MPS * STEP_S
    margin = min(MARGIN_M, 0.2 * min(size_m))
    radius = min(TURN_RADIUS_M, (size_m[1] - 2 * margin) / 6)
    leg = size_m[0] - 2 * margin
    points, east, up = [np.zeros((0, 2))], margin, True
    total, sign = 0.0, 1.0
    while total < LENGTH_M:
        along = np.arange(0, leg, step)
        points.append(np.column_stack([margin + (along if up else leg - along), np.full(len(along), east)]))
        if not margin <= east + 2 * radius * sign <= size_m[1] - margin:
            sign = -sign
        angle = np.arange(0, np.pi, step / radius)
        turn_n = (size_m[0] - margin if up else margin) + (1 if up else -1) * radius * np.sin(angle)
        points.append(np.column_stack([turn_n, east + sign * radius * (1 - np.cos(angle))]))
        east, up = east + 2 * radius * sign, not up
        total += leg + np.pi * radius
    track = np.concatenate(points)[: round(LENGTH_M / step)]
    return np.column_stack([_low_passed(track[:, k], 3.0) for k in (0, 1)])


def _vertical(
    rng: np.random.Generator, course: FloatArray, bias_right: float, tilt: FloatArray, baro_error: FloatArray
) -> FloatArray:
    """(T,) error of a height that is integrated from the accelerometers, gravity reckoned for the barometer's height."""
    n = len(course)
    sensors = np.column_stack([np.full(n, rng.normal(0, ACCELEROMETER)), np.full(n, bias_right), tilt])
    anomaly = _gauss_markov(rng, n, ANOMALY, ANOMALY_M / SPEED_MPS)
    acceleration = (felt(course) * sensors).sum(1) + anomaly + 2 * GRAVITY / EARTH_M * baro_error
    climb = np.cumsum(acceleration * STEP_S + rng.normal(0, VELOCITY_WALK * math.sqrt(STEP_S), n))
    return np.cumsum(climb) * STEP_S


def _inertial(rng: np.random.Generator, course: FloatArray, bias: FloatArray) -> FloatArray:
    """Velocity error (T, 2): accelerometer bias (forward, right) that turns with the vehicle, tilt from the gyroscopes, levelled
    at the start."""
    n = len(course)
    gyro = rng.normal(0, GYROSCOPE, 2)
    c, s = np.cos(course), np.sin(course)
    of_bias = np.column_stack([c * bias[0] - s * bias[1], s * bias[0] + c * bias[1]])
    of_gyro = np.column_stack([c * gyro[0] - s * gyro[1], s * gyro[0] + c * gyro[1]])
    walk = rng.normal(0, ANGLE_WALK * math.sqrt(STEP_S), (n, 2))
    v, tilt = np.zeros(2), -of_bias[0] / GRAVITY
    errors = np.empty((n, 2))
    noise = rng.normal(0, VELOCITY_WALK * math.sqrt(STEP_S), (n, 2))
    for k in range(n):
        v = v + (of_bias[k] + GRAVITY * tilt) * STEP_S + noise[k]
        tilt = tilt + (of_gyro[k] - v / EARTH_M) * STEP_S + walk[k]
        errors[k] = v
    return errors


def _odometry(rng: np.random.Generator, course: FloatArray, heading_error: FloatArray) -> FloatArray:
    n = len(course)
    scale = _gauss_markov(rng, n, SCALE, SCALE_S) * SPEED_MPS
    aside = heading_error * SPEED_MPS
    c, s = np.cos(course), np.sin(course)
    noise = np.column_stack([_gauss_markov(rng, n, ODOMETRY_MPS, ODOMETRY_S) for _ in range(2)])
    return np.column_stack([c * scale - s * aside, s * scale + c * aside]) + noise


def _gauss_markov(rng: np.random.Generator, n: int, sigma: float, correlation_s: float) -> FloatArray:
    a = math.exp(-STEP_S / correlation_s)
    driven = rng.normal(0, sigma * math.sqrt(1 - a * a), n)
    value, values = rng.normal(0, sigma), np.empty(n)
    for k in range(n):
        value = a * value + driven[k]
        values[k] = value
    return values


def _low_passed(values: FloatArray, sigma_s: float) -> FloatArray:
    n = round(3 * sigma_s / STEP_S)
    kernel = np.exp(-0.5 * np.square(np.arange(-n, n + 1) * STEP_S / sigma_s))
    return np.convolve(np.pad(values, n, mode="edge"), kernel / kernel.sum(), mode="valid")
