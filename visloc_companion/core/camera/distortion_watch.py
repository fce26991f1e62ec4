"""Tells a lens that bends the picture otherwise than configured: over ground that goes by, the picture then turns though the
camera does not.

A camera that moves straight ahead sees the middle of the ground go by faster than its borders where these are drawn in (barrel
distortion, k1 below 0). The turn that explains this best is about the axis across the way, by -2 k1 times the way over the
height: 17 degrees for one height and k1 = -0.15, each time anew, where attitudes of the autopilot do not drift at all. A
focal length, a principal point, a rolling shutter or a tilt of the mounting change pictures linearly, which from one frame to the
next a plane's motion explains without any turn. Neither GNSS nor map has a part in it, but for the speed.

Seen less reported turn = bend * gain * (way x axis) + across * way + mounting x turn + scale * turn, by least squares with
Cauchy weights; the latter two are what a mounting and a focal length that are off do while the camera turns. The gain is 1 for a
camera that looks straight down and less for one that leans.

It is asked for a whole flight, so what a doubt takes has to be rare by chance over hours: neighbouring turns err by the same
ground and the same attitude, and count as no more than the way they cover.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from visloc_companion.core.attitude import AttitudeBuffer
from visloc_companion.core.camera.gimbal import Gimbal, camera_turn
from visloc_companion.core.timesync import ClockOffset
from visloc_companion.geo import se3
from visloc_companion.types import Command, FloatArray, Notice, Quat, Severity, Turn, Vec3

LEAST_HEIGHT_M = 15.0
LEAST_WAY, MOST_WAY = 0.008, 0.3
"""Between two frames, over the height: less tells little beside the errors, more is seldom followed right."""
MOST_TURN_RAD = math.radians(25.0)
SIGMA_RAD, SIGMA_SHARE = math.radians(0.1), 0.05
"""1-sigma of a seen turn against a reported one: constant, and share of it."""
PRIOR_SIGMAS = (1.0, 1.0, math.radians(6.0), math.radians(6.0), math.radians(10.0), 0.5)
"""Bend and across; mounting about forward, right and down; scale."""
BEND, ACROSS, MOUNT, SCALE = 0, 1, slice(2, 5), 5
CAUCHY, STEPS, LEAST_SCATTER = 2.4, 8, 0.3
"""The last: what turns may scatter less than SIGMA_RAD and SIGMA_SHARE; few of them do not show it well."""
GROUPS, GROUPED = 12, 8
"""Turns that follow each other may err alike: so many groups of them at least, of so many at most."""
ALONG_LOSS, ACROSS_LOSS, LEAST_GAIN = 1.33, 0.4, 0.3
"""Of the gain, times the squared sine of the lean along and across the way: measured on exact points at 10 to 40 degrees, to
0.08."""
KEPT, FEWEST, EVERY = 400, 16, 4
"""Turns that are kept, before the first judgement, and from one judgement to the next."""
DOUBT_K1, DOUBT_SIGMAS, DOUBT_FEWEST, DOUBT_EVERY, DOUBT_HEIGHTS = 0.02, 4.0, 12, 2, 0.3
"""Reckoned with from here on."""
CLEAR_K1, CLEAR_SIGMAS = 0.015, 2.5
"""Where it ends: a doubt that comes and goes with each turn would begin what is held against GNSS anew each time."""
COMMON_BEND, COMMON_HEIGHTS, FALLS = 0.017, 2.0, 1.75
"""1-sigma of a bend that neighbouring turns feign, and the way over the height after which it is another: over woods and hills
of 20 m it was 0.003 to 0.012 for a height of way, and -0.011 in the mean. Over woods, leaning by 40 degrees, turns of pictures
feigned 0.06 (before the gain) for one and a half: hence the power of the gain."""
LEAST_HEIGHTS = 1.0
"""Way over the height before the first judgement: relief that looks like a bend has gone by then."""
TELL_K1, SURE_SIGMAS = 0.035, 5.0
LITTLE_HEIGHTS = 2.0
"""Way over the height after which a doubt that is as sure is told, though it is too little to leave the camera out for."""
MOST_ACROSS = 0.35
"""Of the bend: else it is another thing that turns the pictures."""
DOWN: Vec3 = (0.0, 0.0, 1.0)


class DistortionWatch:
    """`on_turn` takes what answers say; `wrong`: the operator was told, and nothing of the camera is to be used; `bend`: by how
    many radians (1-sigma) pictures may turn for a way of one height, 0 while nothing speaks for it, or they are not used."""

    def __init__(self, clock: ClockOffset, attitude: AttitudeBuffer | Gimbal) -> None:
        self._clock, self._attitude = clock, attitude
        self.wrong, self.bend, self._n, self._told = False, 0.0, 0, False
        self._rows: deque[FloatArray] = deque(maxlen=KEPT)

    def on_turn(self, turn: Turn, q_carrier_cambody: Quat, v_ned_mps: Vec3, height_m: float) -> list[Command]:
        """Take a turn of the camera's body, at a velocity and a height above home; says once that the lens bends the picture."""
        first_ns, last_ns = self._clock.boot_ns(turn.t_from_ns), self._clock.boot_ns(turn.t_to_ns)
        if self.wrong or height_m < LEAST_HEIGHT_M or first_ns is None or last_ns is None:
            return []
        reported, q_ned_carrier = camera_turn(self._attitude, q_carrier_cambody, first_ns, last_ns), self._attitude.at(last_ns)
        if reported is None or q_ned_carrier is None or math.hypot(*reported) > MOST_TURN_RAD:
            return []
        q_ned_cambody = se3.quat_multiply(q_ned_carrier, q_carrier_cambody)
        q_cambody_ned = se3.quat_inverse(q_ned_cambody)
        v_cambody_mps, down = np.array(se3.rotate(q_cambody_ned, v_ned_mps)), np.array(se3.rotate(q_cambody_ned, DOWN))
        way = v_cambody_mps * ((turn.t_to_ns - turn.t_from_ns) * 1e-9 / height_m)
        if not LEAST_WAY <= math.hypot(*way[:2]) <= MOST_WAY:
            return []
        self._n += 1
        self._rows.append(_row(np.array(se3.vector_from_quat(turn.q_from_to)), np.array(reported), way, _gain(way, down)))
        return self._judged() if len(self._rows) >= DOUBT_FEWEST and self._n % DOUBT_EVERY == 0 else []

    def _judged(self) -> list[Command]:
        rows = np.array(self._rows)
        heights = float(np.hypot(rows[:, 0, ACROSS], rows[:, 1, ACROSS]).sum())
        if heights < DOUBT_HEIGHTS:
            return []
        x, sigma = _solved(rows)
        k1, k1_sigma = -x[BEND] / 2, math.hypot(sigma[BEND], _common_sigma(rows, heights)) / 2
        least_k1, sigmas = (CLEAR_K1, CLEAR_SIGMAS) if self.bend else (DOUBT_K1, DOUBT_SIGMAS)
        doubted = abs(k1) >= max(least_k1, sigmas * k1_sigma)
        self.bend = 2 * float(abs(k1) + k1_sigma) if doubted else 0.0
        due = len(rows) >= FEWEST and self._n % EVERY == 0 and heights >= LEAST_HEIGHTS
        sure = abs(k1) >= max(DOUBT_K1, SURE_SIGMAS * k1_sigma) and abs(x[ACROSS]) <= MOST_ACROSS * abs(x[BEND])
        if not (due and doubted and sure):
            return []
        self.wrong = bool(abs(k1) >= TELL_K1)
        if not self.wrong and (self._told or heights < LITTLE_HEIGHTS):
            return []
        self._told = True
        if self.wrong:
            self.bend = 0.0
        text = f"visloc: lens, k1 off by about {k1:+.2f}: calibrate"
        data = (("k1_off", float(k1)), ("sigma", float(k1_sigma)), ("turns", float(len(rows))))
        return [Notice(Severity.WARNING, text, to_operator=True, data=data)]


def _gain(way: FloatArray, down: FloatArray) -> float:
    """By how much less a bend turns the pictures of a camera that leans: `way` (3,) and `down` (3,) in its body's axes."""
    along = float(way[:2] @ down[:2]) / math.hypot(*way[:2])
    across2 = max(0.0, float(down[:2] @ down[:2]) - along**2)
    return max(LEAST_GAIN, 1 - ALONG_LOSS * along**2 - ACROSS_LOSS * across2)


def _common_sigma(rows: FloatArray, heights: float) -> float:
    """1-sigma of the bend for what turns have in common, of rows (N, 2, 8) on a way over the height. Who leans sees less of a
    bend, and more of what stands on the ground."""
    gain = float(np.linalg.norm(rows[:, :, BEND]) / np.linalg.norm(rows[:, :, ACROSS]))
    return COMMON_BEND / math.pow(gain, FALLS) / math.sqrt(1 + heights / COMMON_HEIGHTS)


def _row(seen: FloatArray, reported: FloatArray, way: FloatArray, gain: float) -> FloatArray:
    """(2, 8) of what is seen less what is reported about forward and right: what bend, across, mounting and scale make of it,
    itself, and its 1-sigma."""
    x, y, z = reported
    forward = (gain * way[1], way[0], 0.0, z, -y, x)
    right = (-gain * way[0], way[1], -z, 0.0, x, y)
    off, sigma = seen - reported, SIGMA_RAD + SIGMA_SHARE * float(np.linalg.norm(reported))
    return np.array([(*forward, off[0], sigma), (*right, off[1], sigma)])


def _median(of: FloatArray) -> float:
    """Of values (N,), all finite: what np.median gives, in a seventh of its time."""
    ordered, middle = np.sort(of), len(of) // 2
    return float(ordered[middle] if len(of) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _solved(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(6,) bend, across, mounting and scale that fit rows (N, 2, 8), and their 1-sigmas (6,), no less than what groups of
    neighbouring turns differ by (Liang and Zeger 1986)."""
    A, off = rows[:, :, :6] / rows[:, :, 7:], rows[:, :, 6] / rows[:, :, 7]
    information = np.diag(np.square(PRIOR_SIGMAS) ** -1)
    fitted = math.sqrt(len(A) / (len(A) - 3))  # six unknowns take so much of the scatter
    weight: FloatArray = np.ones(len(A))
    x: FloatArray = np.zeros(6)
    normal, scatter = information, 1.0
    flat, flat_off = A.reshape(-1, 6), off.ravel()
    for _ in range(STEPS):
        weighted = (A * weight[:, None, None]).reshape(-1, 6)
        normal = weighted.T @ flat / scatter**2 + information
        x = np.asarray(np.linalg.solve(normal, weighted.T @ flat_off / scatter**2), dtype=np.float64)
        left = off - A @ x
        size = np.sqrt(np.add.reduce(left * left, 1))
        scatter = max(LEAST_SCATTER, fitted * _median(size) / 1.1774)
        weight = 1 / (1 + (size / (CAUCHY * scatter)) ** 2)
    inverse = np.linalg.inv(normal)
    pulls = ((A * weight[:, None, None]).transpose(0, 2, 1) @ (off - A @ x)[:, :, None])[:, :, 0] / scatter**2 @ inverse
    firsts = np.arange(0, len(A), max(1, min(GROUPED, len(A) // GROUPS)))
    grouped = np.add.reduceat(pulls, firsts)
    between = (grouped**2).sum(0) * len(firsts) / (len(firsts) - 3)
    return x, np.sqrt(np.maximum(np.diag(inverse), between))
