"""Tells a camera that is mounted otherwise than configured by more than boresight.py learns: pictures turn about other axes.

How the picture turned (Turn) is measured in the camera's true axes, by the picture alone; how the autopilot says that the camera
turned, in the configured ones. The rotation that takes one to the other (Wahba's problem, solved as by Kabsch 1976, with Cauchy
weights) is what the mounting is off by. Neither GNSS nor compass nor map has a part in it, so that it holds where no frame is
recognised. Stamps may be late: the rotation is sought at several delays, and a mounting that is right at any of them is right.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import Gimbal, camera_turn
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Command, FloatArray, Notice, Quat, Severity, Turn

DELAYS_NS = tuple(1_000_000 * late_ms for late_ms in (0, 50, 100, 150, 200, 300, 400, 500))
LEAST_TURN_RAD, MOST_TURN_RAD = math.radians(0.3), math.radians(25.0)
"""Smaller turns between two frames say little beside their errors, larger ones are seldom followed right."""
SIGMA_RAD, SIGMA_SHARE, SHARE_BY_OFF = math.radians(0.1), 0.03, 0.1
"""1-sigma of a seen turn against a reported one: constant, and shares of it, the last times 1 - cos of what the mounting is off:
who believes down to be elsewhere follows the ground less well."""
FITS_SIGMAS, CAUCHY, STEPS = 3.0, 2.4, 4
KEPT, FEWEST, EVERY = 120, 24, 4
"""Turns that are kept, before the first judgement, and from one judgement to the next."""
FEWEST_TELLING, LEAST_FIT_FOUND, MOST_FIT_CONFIGURED = 10, 0.6, 0.4
"""Turns by which the two mountings can be told apart, and shares of them: one may be followed wrong, or fit by chance."""
LEAST_LOG_ODDS = 20.0
"""Natural logarithm of by how much likelier all turns are with the found mounting; neighbours share a frame. Of cameras that are
mounted as configured it was at most 3 in simulated flights of copters, planes and gimbals."""
TAKEN_BACK = 2
"""Turns that a recognised frame speaks against: with a wrong mounting one in ten or twenty may be, most of them wrongly."""
LEAST_ACROSS_RAD2 = math.radians(3.0) ** 2
"""Summed squares of what was turned about other axes than the main one: else the rotation about that one is open."""
TELL_RAD = math.radians(10.0)
LEAST_DOWN = 0.3
"""Cosine between the two optical axes: beyond, it is a mirrored picture, which turns like one from below (mirror_watch.py)."""
ALONE_RAD = math.radians(8.0)
"""One angle is named alone where it leaves no more: boresight.py learns up to 6 degrees from fixes, some of this is error."""
SNAP_DEG = 4.0
"""A yaw so near to a multiple of 90 degrees is meant to be one."""
NAMES = ("roll", "pitch", "yaw")


class MountWatch:
    """`on_turn` takes what answers say; `wrong`: the operator was told, and nothing of the camera is to be used."""

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer | Gimbal, q_carrier_cambody: Quat) -> None:
        """`q_carrier_cambody`: the mounting as it is configured."""
        self._clock, self._attitude, self._configured = clock, attitude, q_carrier_cambody
        self.wrong, self._n = False, 0
        self._turns: deque[FloatArray] = deque(maxlen=KEPT)

    def recognised(self) -> None:
        """A place was found in the picture, which is seldom possible with such a mounting: the oldest turns are left out."""
        for _ in range(min(TAKEN_BACK, len(self._turns))):
            self._turns.popleft()

    def on_turn(self, turn: Turn) -> list[Command]:
        """Take a turn of the camera's body; says once how the camera seems to be mounted."""
        first_ns, last_ns = self._clock.boot_ns(turn.t_from_ns), self._clock.boot_ns(turn.t_to_ns)
        if self.wrong or first_ns is None or last_ns is None:
            return []
        seen = se3.vector_from_quat(turn.q_from_to)
        if not LEAST_TURN_RAD <= math.hypot(*seen) <= MOST_TURN_RAD:
            return []
        reported = [camera_turn(self._attitude, self._configured, first_ns - late, last_ns - late) for late in DELAYS_NS]
        known = [one for one in reported if one is not None]
        if len(known) < len(DELAYS_NS):
            return []
        self._n += 1
        self._turns.append(np.array([seen, *known]))
        return self._judged() if len(self._turns) >= FEWEST and self._n % EVERY == 0 else []

    def _judged(self) -> list[Command]:
        turns = np.array(self._turns)
        seen, delayed = turns[:, 0], [turns[:, k] for k in range(1, turns.shape[1])]
        found = [rotation_between(seen, reported) for reported in delayed]
        likely = [_log_likelihood(seen, one @ R.T, SIGMA_SHARE) for one, R in zip(delayed, found, strict=True)]
        best = int(np.argmax(likely))
        R, reported = found[best], delayed[best]
        share = _share(R)
        fits = _fits(seen, reported @ R.T, share)
        telling = ~_fits(reported @ R.T, reported, share)
        if telling.sum() < FEWEST_TELLING or fits[telling].mean() < LEAST_FIT_FOUND:
            return []
        as_configured = max(_log_likelihood(seen, one, share) for one in delayed)
        fit_configured = max(float(_fits(seen, one, share)[telling].mean()) for one in delayed)
        log_odds = _log_likelihood(seen, reported @ R.T, share) - as_configured
        if log_odds < LEAST_LOG_ODDS or fit_configured > MOST_FIT_CONFIGURED:
            return []
        across = np.linalg.eigvalsh(reported[fits].T @ reported[fits])[:2].sum()
        off_rad = se3.angle_between(se3.quat_from_R(R), (1.0, 0.0, 0.0, 0.0))
        if off_rad < TELL_RAD or across < LEAST_ACROSS_RAD2 or R[2, 2] < LEAST_DOWN:
            return []
        self.wrong = True
        mounted = _mounted(self._configured, R)
        data = (*zip(NAMES, _degrees(mounted), strict=True), ("turns", float(telling.sum())))
        return [Notice(Severity.WARNING, _remedy(self._configured, mounted), to_operator=True, data=data)]


def rotation_between(seen: FloatArray, reported: FloatArray) -> FloatArray:
    """(3, 3) the rotation from reported (N, 3) to seen (N, 3) turns that fits most of them."""
    weights, R = np.ones(len(seen)), np.eye(3)
    for _ in range(STEPS):
        U, _, Vt = np.linalg.svd((weights / _sigma_rad(seen) ** 2 * seen.T) @ reported)
        R = U @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt
        off = np.linalg.norm(seen - reported @ R.T, axis=1) / _sigma_rad(seen)
        weights = 1 / (1 + (off / CAUCHY) ** 2)
    return np.asarray(R, dtype=np.float64)


def _share(R: FloatArray) -> float:
    """Share of a turn that is its 1-sigma while the mounting is believed to be off by a rotation (3, 3)."""
    return SIGMA_SHARE + SHARE_BY_OFF * (3 - float(np.trace(R))) / 2


def _sigma_rad(turns: FloatArray, share: float = SIGMA_SHARE) -> FloatArray:
    return np.asarray(SIGMA_RAD + share * np.linalg.norm(turns, axis=1), dtype=np.float64)


def _log_likelihood(seen: FloatArray, expected: FloatArray, share: float) -> float:
    """Of turns (N, 3), by Cauchy's distribution of their sizes off."""
    off = np.linalg.norm(seen - expected, axis=1) / _sigma_rad(seen, share)
    return -float(np.log1p((off / CAUCHY) ** 2).sum())


def _fits(a: FloatArray, b: FloatArray, share: float) -> NDArray[np.bool_]:
    """(N,) whether turns (N, 3) are the same within their errors."""
    return np.asarray(np.linalg.norm(a - b, axis=1) < FITS_SIGMAS * _sigma_rad(a, share), dtype=np.bool_)


def _mounted(configured: Quat, R_cam_configured: FloatArray) -> Quat:
    """The mounting as it is found."""
    return se3.quat_multiply(configured, se3.quat_inverse(se3.quat_from_R(R_cam_configured)))


def _degrees(q: Quat) -> list[float]:
    """Roll, pitch and yaw; a yaw near a multiple of 90 is that."""
    roll, pitch, yaw = (math.degrees(angle) for angle in se3.euler_from_quat(q))
    quarters = 90.0 * round(yaw / 90)
    return [roll, pitch, quarters if abs(yaw - quarters) < SNAP_DEG else yaw]


def _remedy(configured: Quat, found: Quat) -> str:
    """The field that differs and what to try, or all three; at most 50 characters."""
    degrees = [180 if round(angle) == -180 else round(angle) for angle in _degrees(found)]
    for k, verb in enumerate(("tilted", "tilted", "turned")):
        alone = [math.degrees(angle) for angle in se3.euler_from_quat(configured)]
        alone[k] = degrees[k]
        roll, pitch, yaw = (math.radians(angle) for angle in alone)
        if se3.angle_between(se3.quat_from_euler(roll, pitch, yaw), found) < ALONE_RAD:
            return f"visloc: camera {verb}, try mount_{NAMES[k]}_deg = {degrees[k]}"
    return "visloc: try mount roll {} pitch {} yaw {} deg".format(*degrees)
