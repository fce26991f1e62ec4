"""Inertial filter of the simulated autopilot: delayed fusion horizon, output predictor, and an account of what spoofing did.

Each axis is a Kalman filter of position and velocity that runs `horizon_s` behind and integrates measured accelerations;
corrections made there are carried to the present, which follows them as EKF3's and EKF2's output predictor does
(estimator_output.py). The same gains act on `pull`, the part of the estimate that false GNSS alone produced: the filter is
linear, so this separation is exact.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from random import Random

from visloc_companion.sim.estimators.estimator_output import Due, OutputTaus
from visloc_companion.sim.vehicles.imu import QUIET, TILT_TAU_S, Imu
from visloc_companion.sim.vehicles.vehicle_noise import GaussMarkov
from visloc_companion.types import Vec2, Vec3

GRAVITY_MPS2 = 9.81
BARO_SIGMA_M, BARO_PERIOD_S = 2.0, 0.1


class Axis:
    """One axis: delayed position and velocity `p`, `v`, present ones `p_now`, `v_now`, covariance, and the pull of GNSS.

    `tilt` is the acceleration (m/s²) by which the filter has set its attitude right, `drift` what it changes by by itself (m/s³):
    the bias of the gyroscope that the filter reckons with.
    """

    __slots__ = (
        "P11", "P12", "P13", "P14", "P22", "P23", "P24", "P33", "P34", "P44", "drift", "due", "imu", "lag_s",
        "p", "p_now", "pull_a", "pull_d", "pull_p", "pull_v", "tilt", "v", "v_now",
    )  # fmt: skip

    def __init__(self, lag_s: float, imu: Imu = QUIET, taus: OutputTaus | None = None) -> None:
        self.lag_s, self.imu, self.due = lag_s, imu, Due(taus or OutputTaus())
        self.p = self.v = self.p_now = self.v_now = self.tilt = self.drift = 0.0
        self.pull_p = self.pull_v = self.pull_a = self.pull_d = 0.0
        self.P11, self.P12, self.P22 = 1.0, 0.0, 0.25
        self.P13 = self.P23 = self.P33 = self.P14 = self.P24 = self.P34 = self.P44 = 0.0

    def predict(self, a_delayed: float, a_now: float, dt_s: float) -> None:
        """Advance both times by one step."""
        drifted = self.drift * dt_s
        self.tilt += drifted
        self.due.v += drifted * self.lag_s
        self.due.p += drifted * self.lag_s * self.lag_s / 2
        a_delayed, a_now = a_delayed + self.tilt, a_now + self.tilt
        self.p += (self.v + 0.5 * a_delayed * dt_s) * dt_s
        self.v += a_delayed * dt_s
        self.p_now += (self.v_now + 0.5 * a_now * dt_s) * dt_s
        self.v_now += a_now * dt_s
        self._follow(dt_s)
        self.pull_p += self.pull_v * dt_s
        self.pull_v += self.pull_a * dt_s
        self.pull_a += self.pull_d * dt_s
        self.P11 += (2 * self.P12 + self.P22 * dt_s) * dt_s
        self.P12 += (self.P22 + self.P13) * dt_s
        self.P13 += (self.P23 + self.P14) * dt_s
        self.P14 += self.P24 * dt_s
        self.P22 += (self.imu.assumed_accel_psd + 2 * self.P23) * dt_s
        self.P23 += (self.P33 + self.P24) * dt_s
        self.P24 += self.P34 * dt_s
        self.P33 += (self.imu.assumed_tilt_psd + 2 * self.P34) * dt_s
        self.P34 += self.P44 * dt_s
        self.P44 += self.imu.assumed_drift_psd * dt_s

    def correct_position(self, p: float, variance: float, false_m: float) -> None:
        """Fuse a position valid at the delayed time; `false_m` is its spoofed part."""
        s = self.P11 + variance
        k1, k2, k3, k4 = self.P11 / s, self.P12 / s, self.P13 / s, self.P14 / s
        self._apply(k1, k2, k3, k4, p - self.p, false_m - self.pull_p)
        self.P44 -= k4 * self.P14
        self.P34 -= k3 * self.P14
        self.P24 -= k2 * self.P14
        self.P14 *= 1 - k1
        self.P33 -= k3 * self.P13
        self.P23 -= k2 * self.P13
        self.P22 -= k2 * self.P12
        self.P13 *= 1 - k1
        self.P12 *= 1 - k1
        self.P11 *= 1 - k1

    def correct_velocity(self, v: float, variance: float, false_mps: float) -> None:
        """Fuse a velocity valid at the delayed time."""
        s = self.P22 + variance
        k1, k2, k3, k4 = self.P12 / s, self.P22 / s, self.P23 / s, self.P24 / s
        self._apply(k1, k2, k3, k4, v - self.v, false_mps - self.pull_v)
        self.P44 -= k4 * self.P24
        self.P34 -= k3 * self.P24
        self.P14 -= k1 * self.P24
        self.P24 *= 1 - k2
        self.P33 -= k3 * self.P23
        self.P13 -= k1 * self.P23
        self.P11 -= k1 * self.P12
        self.P23 *= 1 - k2
        self.P12 *= 1 - k2
        self.P22 *= 1 - k2

    def _apply(self, k1: float, k2: float, k3: float, k4: float, innovation: float, pull_innovation: float) -> None:
        self.p += k1 * innovation
        self.v += k2 * innovation
        self.tilt += k3 * innovation
        self.drift += k4 * innovation
        self.due.p += (k1 + (k2 + k3 * self.lag_s / 2) * self.lag_s) * innovation
        self.due.v += (k2 + k3 * self.lag_s) * innovation
        self.pull_p += k1 * pull_innovation
        self.pull_v += k2 * pull_innovation
        self.pull_a += k3 * pull_innovation
        self.pull_d += k4 * pull_innovation

    def _follow(self, dt_s: float) -> None:
        p, v = self.due.step(dt_s)
        self.p_now += p
        self.v_now += v

    def reset_position(self, p: float, variance: float, false_m: float) -> None:
        """Jump to a position; the velocity stays."""
        self.p_now += p - self.p
        self.p, self.pull_p = p, false_m
        self.P11, self.P12, self.P13, self.P14 = variance, 0.0, 0.0, 0.0

    def reset_velocity(self, v: float, variance: float, false_mps: float) -> None:
        """Jump to a velocity; the present position follows over the lag."""
        self.p_now += (v - self.v) * self.lag_s
        self.v_now += v - self.v
        self.v, self.pull_v = v, false_mps
        self.P22, self.P12, self.P23, self.P24 = variance, 0.0, 0.0, 0.0

    def shift(self, by_m: float) -> None:
        """Move the origin of the axis."""
        self.p += by_m
        self.p_now += by_m

    @property
    def pull_m(self) -> float:
        """How far false GNSS has moved the present estimate."""
        return self.pull_p + self.pull_v * self.lag_s


@dataclass(frozen=True, slots=True)
class Fixed:
    """A horizontal position for fusion: valid at `t_s`, in the autopilot's local metres, with variances and its false part."""

    t_s: float
    north_m: float
    east_m: float
    var_north_m2: float
    var_east_m2: float
    false_north_m: float = 0.0
    false_east_m: float = 0.0


class InertialFilter:
    """Three axes on measured accelerations, with height from a drifting barometer.

    The accelerometer's net error (bias and tilt, as far as the autopilot has not learnt them) varies slowly with 1-sigma
    0.015 m/s², plus what `imu` says; the barometer drifts by 0.3 m in 120 s.
    """

    def __init__(self, rng: Random, horizon_s: float, dt_s: float, imu: Imu = QUIET, taus: OutputTaus | None = None) -> None:
        self.horizon_s, self._imu = horizon_s, imu
        self.north, self.east = Axis(horizon_s, imu, taus), Axis(horizon_s, imu, taus)
        self.down = Axis(horizon_s, taus=taus)
        self.t_s = 0.0
        self._rng = rng
        self._bias = tuple(GaussMarkov(rng, 0.015, 60.0) for _ in range(3))
        self._baro_drift = GaussMarkov(rng, 0.3, 120.0)
        self._baro_due_s = 0.0
        self._tilt_n = self._tilt_e = 0.0
        self._accelerations: deque[Vec3] = deque([(0.0, 0.0, 0.0)] * max(1, round(horizon_s / dt_s)))
        self._baro: deque[tuple[float, float]] = deque()
        self.at_rest = False
        """Whether the vehicle stands on the ground."""
        self.baro_error_m = 0.0
        """What a fault adds to the barometer's height (up)."""
        self.baro_down_m = 0.0
        """The barometer's last reading, as a position down of home."""
        self.origin_above_home_m = 0.0
        """By how much the local metres begin above home's ground: the barometer knows nothing of any origin."""

    def align(self, p_ned_m: Vec3, v_ned_mps: Vec3, false_ne_m: Vec2 = (0.0, 0.0), false_ne_mps: Vec2 = (0.0, 0.0)) -> None:
        """Start at a position and velocity, at rest in acceleration; `false_*` is what false GNSS added to them."""
        for axis, p, v in zip((self.north, self.east, self.down), p_ned_m, v_ned_mps, strict=True):
            axis.p_now, axis.v_now, axis.v, axis.p = p, v, v, p - v * self.horizon_s
        for axis, false_m, false_mps in zip((self.north, self.east), false_ne_m, false_ne_mps, strict=True):
            axis.pull_p, axis.pull_v = false_m - false_mps * self.horizon_s, false_mps

    @property
    def tilt_ne_rad(self) -> tuple[float, float]:
        """By how much the attitude is tilted about north and east, radians: a false tilt turns gravity into accelerations."""
        return (self._tilt_e + self.east.tilt) / GRAVITY_MPS2, -(self._tilt_n + self.north.tilt) / GRAVITY_MPS2

    @property
    def t_delayed_s(self) -> float:
        """The time at which measurements are fused."""
        return self.t_s - self.horizon_s

    def step(self, accel_ned_mps2: Vec3, yaw_error_rad: float, true_down_m: float, dt_s: float, yaw_rad: float = 0.0) -> None:
        """Advance by the true acceleration, seen through the sensors' and the heading's errors, and sample the barometer.

        `true_down_m` is down of home, `yaw_rad` where the sensors' forward axis points.
        """
        gauss, (forward, right) = self._rng.gauss, self._imu.noise_mps2
        a_n, a_e, a_d = accel_ned_mps2
        bias_n, white_n = self._bias[0].step(dt_s), gauss(0.0, forward)
        bias_e, white_e = self._bias[1].step(dt_s), gauss(0.0, right)
        if forward != right:
            white_n, white_e = _turned(white_n, white_e, yaw_rad)
        self._tilt_on(dt_s, yaw_rad)
        now = (
            a_n - a_e * yaw_error_rad + bias_n + white_n + self._tilt_n,
            a_e + a_n * yaw_error_rad + bias_e + white_e + self._tilt_e,
            a_d + self._bias[2].step(dt_s) + gauss(0.0, 0.1),
        )
        self._accelerations.append(now)
        delayed = self._accelerations.popleft()
        self.north.predict(delayed[0], now[0], dt_s)
        self.east.predict(delayed[1], now[1], dt_s)
        self.down.predict(delayed[2], now[2], dt_s)
        self.t_s += dt_s
        if self.t_s >= self._baro_due_s:
            self._baro_due_s += BARO_PERIOD_S
            self.baro_down_m = true_down_m - self.baro_error_m + self._baro_drift.step(BARO_PERIOD_S) + gauss(0.0, 0.1)
            self._baro.append((self.t_s, self.baro_down_m))

    def _tilt_on(self, dt_s: float, yaw_rad: float) -> None:
        """Let the gyroscopes' noise tilt the attitude a step further."""
        pitch, roll = self._imu.tilt_psd
        if pitch or roll:
            decay = math.exp(-dt_s / TILT_TAU_S)
            forward, right = self._rng.gauss(0.0, math.sqrt(pitch * dt_s)), self._rng.gauss(0.0, math.sqrt(roll * dt_s))
            north, east = _turned(forward, right, yaw_rad)
            self._tilt_n, self._tilt_e = self._tilt_n * decay + north, self._tilt_e * decay + east

    def fuse_baro(self, use: bool = True) -> None:
        """Fuse (or pass over) the barometer readings that the fusion horizon has reached."""
        while self._baro and self._baro[0][0] <= self.t_delayed_s:
            down = self._baro.popleft()[1]
            if use:
                self.down.correct_position(down + self.origin_above_home_m, BARO_SIGMA_M**2, 0.0)

    def hold(self) -> None:
        """Keep the position still, as ArduPilot does without any aiding, PX4 only at rest (constant position mode)."""
        self._accelerations = deque((self._tilt_n, self._tilt_e, a[2]) for a in self._accelerations)
        self.north.tilt, self.east.tilt = -self._tilt_n, -self._tilt_e
        for axis in (self.north, self.east):
            axis.p = axis.p_now
            axis.v = axis.v_now = axis.pull_v = axis.pull_a = axis.pull_d = axis.drift = 0.0
            axis.due.clear()
            axis.P11, axis.P12, axis.P13, axis.P14 = 25.0, 0.0, 0.0, 0.0
            axis.P22, axis.P23, axis.P24 = 1.0, 0.0, 0.0

    def ratio(self, fix: Fixed, gate_sigma: float) -> float:
        """Innovation test ratio of a position, 1 at the gate (squared; the status messages send its root)."""
        n, e = fix.north_m - self.north.p, fix.east_m - self.east.p
        s = (self.north.P11 + fix.var_north_m2 + self.east.P11 + fix.var_east_m2) / 2
        return (n * n + e * e) / (gate_sigma * gate_sigma * s)

    def velocity_ratio(self, v_north: float, v_east: float, variance: float, gate_sigma: float) -> float:
        """The same for a velocity."""
        n, e = v_north - self.north.v, v_east - self.east.v
        return (n * n + e * e) / (gate_sigma * gate_sigma * ((self.north.P22 + self.east.P22) / 2 + variance))

    def fuse(self, fix: Fixed) -> None:
        """Fuse a position at the delayed time."""
        self.north.correct_position(fix.north_m, fix.var_north_m2, fix.false_north_m)
        self.east.correct_position(fix.east_m, fix.var_east_m2, fix.false_east_m)

    def reset_to(self, fix: Fixed) -> None:
        """Jump to a position at the delayed time."""
        self.north.reset_position(fix.north_m, fix.var_north_m2, fix.false_north_m)
        self.east.reset_position(fix.east_m, fix.var_east_m2, fix.false_east_m)

    @property
    def pull_ned_m(self) -> tuple[float, float]:
        """North and east by which false GNSS has moved the present estimate, m."""
        return self.north.pull_m, self.east.pull_m


def _turned(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    """North and east of a vector in the frame of a heading."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward * c - right * s, forward * s + right * c
