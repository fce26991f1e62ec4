"""How the camera is really mounted: small constant turns against the configuration, learned from fixes while GNSS is good.

A tilt of the mounting moves what is looked at, and so each fix, by a share of the height that turns with the vehicle; what GNSS
and map differ by stays where it is, and the receiver's delay grows with the speed. A Kalman filter of these six (turn about the
vehicle's axes 3, difference north and east 2, delay 1) tells them apart as far as the flight allows it: straight ahead at one
speed it does not, and the sigma says so. A fix moves the camera and tilts it, in shares that depend on how it was solved; the
ground that it looks at is where the picture puts it in either case, so that place is what is compared.
"""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.core import kalman
from visloc_companion.core.remembered import remember
from visloc_companion.geo import se3
from visloc_companion.types import Command, Fix, FloatArray, LocaliseRequest, Notice, Quat, Rejected, Severity, Vec2, Vec3

TURN, DIFFERENCE, DELAY, STATES = slice(0, 3), slice(3, 5), 5, 6
FIRST_SIGMA = np.array([math.radians(2.0)] * 2 + [math.radians(4.0), 3.0, 3.0, 0.1])
"""Roll, pitch, heading; difference (m); delay (s)."""
WALK_PER_SQRT_S = np.array([2e-5] * 3 + [0.1, 0.1, 1e-4])
GNSS_SIGMA_M = 1.0
TILT_SIGMA_RAD, TILT_S = math.radians(0.3), 20.0
HEADING_SIGMA_RAD, HEADING_S = math.radians(1.0), 60.0
"""The autopilot's own attitude errs by so much for so long: values closer together say the same again."""
EVERY_NS = 1_000_000_000
SURE = 0.01
GATE_SIGMA = 5.0
MIN_HEIGHT_M = 20.0
USE_RAD = np.radians([0.6, 0.6, 1.2])
"""A turn is used once its 1-sigma is below this: well below what priors claim of tilt (1 degree) and heading (5)."""
FOLLOW_RAD = math.radians(0.2)
LARGEST_RAD = math.radians(6.0)
TELL_RAD = math.radians(3.0)


class Boresight:
    """`q_frd_cambody` is the mounting to be used; `on_request` and `on_fix` learn it."""

    def __init__(self, q_frd_cambody: Quat) -> None:
        self._configured = q_frd_cambody
        self._used = np.zeros(3)
        self._x = np.zeros(STATES)
        self._P = np.diag(FIRST_SIGMA**2)
        self._t_ns: int | None = None
        self._asked: dict[int, tuple[Quat, FloatArray]] = {}
        self._told = False
        self.q_frd_cambody = q_frd_cambody

    @property
    def turn_rad(self) -> FloatArray:
        """(3,) estimated turn about the vehicle's forward, right and down axes, beyond the configuration."""
        return np.array(self._x[TURN])

    @property
    def used_rad(self) -> FloatArray:
        """(3,) how much of it `q_frd_cambody` has."""
        return self._used

    @property
    def sigma_rad(self) -> FloatArray:
        """(3,) its 1-sigma."""
        return np.asarray(np.sqrt(np.diag(self._P)[TURN]), dtype=np.float64)

    def on_request(self, request: LocaliseRequest) -> None:
        """Remember with which attitude a frame was asked about."""
        remember(self._asked, request.request_id, (request.prior.q_ned_frd, self._used))

    def on_fix(self, fix: Fix, gnss_minus_fix_m: Vec2, v_ned_mps: Vec3, height_m: float) -> list[Command]:
        """Take a fix while GNSS is trusted: what GNSS makes of its place, and velocity and height above ground at its time."""
        asked = self._asked.pop(fix.request_id, None)
        early = self._t_ns is not None and fix.t_ns - self._t_ns < EVERY_NS
        if asked is None or early or fix.probability_wrong > SURE or height_m < MIN_HEIGHT_M:
            return []
        dt_s = 0.0 if self._t_ns is None else (fix.t_ns - self._t_ns) * 1e-9
        self._t_ns = fix.t_ns
        self._P = self._P + np.diag(WALK_PER_SQRT_S**2) * dt_s
        if self._updated(fix, asked, np.array(gnss_minus_fix_m), np.array(v_ned_mps[:2]), height_m):
            return self._taken_over()
        return []

    def _updated(
        self, fix: Fix, asked: tuple[Quat, FloatArray], gnss_minus_fix_m: FloatArray, v_ne_mps: FloatArray, height_m: float
    ) -> bool:
        q_prior, used = asked
        R_fix, R_prior = se3.R_from_quat(fix.q_ned_frd), se3.R_from_quat(q_prior)
        R_ned_frd = R_prior @ se3.R_from_quat(_turned(self._configured, used)).T
        to, believed = R_fix[:, 2], R_prior[:, 2]
        if min(to[2], believed[2]) < 0.5:
            return False
        looked = height_m * (to[:2] / to[2] - believed[:2] / believed[2])
        heading = _small_turn(R_fix @ R_prior.T)[2]
        z = np.array([*(looked - gnss_minus_fix_m), heading])
        a, b, c = believed
        across = np.array([[0.0, c, -b], [-c, 0.0, a], [b, -a, 0.0]])
        H = np.zeros((3, STATES))
        H[:2, TURN] = height_m * np.array([[1 / c, 0.0, -a / c**2], [0.0, 1 / c, -b / c**2]]) @ across @ R_ned_frd
        H[2, TURN] = R_ned_frd[2]
        H[:2, DIFFERENCE] = np.eye(2)
        H[:2, DELAY] = v_ne_mps
        every_s = EVERY_NS * 1e-9
        tilt = (height_m * TILT_SIGMA_RAD) ** 2 * 2 * TILT_S / every_s
        R = np.zeros((3, 3))
        R[:2, :2] = np.array(fix.cov_ne_m2) + (GNSS_SIGMA_M**2 + tilt) * np.eye(2)
        R[2, 2] = fix.sigma_yaw_rad**2 + HEADING_SIGMA_RAD**2 * 2 * HEADING_S / every_s
        z = z + H[:, TURN] @ used
        outcome = kalman.update(self._x, self._P, z, R, H, gate_sigma=GATE_SIGMA)
        if isinstance(outcome, Rejected):
            return False
        self._x, self._P = outcome.x, outcome.P
        return True

    def _taken_over(self) -> list[Command]:
        """Use what is known well enough and differs from what is in use."""
        found, sigma = self.turn_rad, self.sigma_rad
        change = np.abs(found - self._used) > np.maximum(FOLLOW_RAD, sigma)
        change &= (sigma < USE_RAD) & (np.abs(found) < LARGEST_RAD)
        commands: list[Command] = []
        if change.any():
            self._used = np.where(change, found, self._used)
            self.q_frd_cambody = _turned(self._configured, self._used)
            roll, pitch, yaw = (math.degrees(float(v)) for v in self._used)
            data = (("roll_deg", roll), ("pitch_deg", pitch), ("heading_deg", yaw))
            commands.append(Notice(Severity.INFO, "camera's mounting learned", data=data))
        tilt_rad = math.hypot(float(found[0]), float(found[1]))
        if not self._told and tilt_rad > TELL_RAD and float(sigma[:2].max()) < float(USE_RAD[0]):
            self._told = True
            text = f"visloc: camera tilted {math.degrees(tilt_rad):.0f} deg off config"
            commands.append(Notice(Severity.WARNING, text, to_operator=True))
        return commands


def _turned(q_frd_cambody: Quat, turn_rad: FloatArray) -> Quat:
    """The mounting turned about the vehicle's axes by a small vector."""
    x, y, z = turn_rad.tolist()
    return se3.quat_multiply(se3.quat_from_vector((x, y, z)), q_frd_cambody)


def _small_turn(R: FloatArray) -> FloatArray:
    """(3,) vector of a turn of less than a right angle, radians."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    size = float(np.linalg.norm(v))
    return v if size < 1e-9 else np.asarray(v * (math.asin(min(1.0, size)) / size))
