"""What a horizontal position is made wrong by, term by term, from what is stated of each source: an error budget as for landings
on Mars (Johnson et al., "The Lander Vision System for Mars 2020 Entry Descent and Landing", AAS 2017).

Every term is a pair of 1-sigmas (metres) along and across the course. The terms are independent, so their squares add up, on each
axis; a share of the errors of an elliptical Gaussian lies within `radial_m`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visloc_companion.core.filter import lasting
from visloc_companion.core.filter.propagation import ACCELERATION, LASTING, Drive, initial_covariance, step
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.localise.ortho_rectify import MAX_TAN_INCIDENCE
from visloc_companion.types import FloatArray

ANGLES = 720
LATTICE = 24
"""Rays of the camera on each axis, for what a picture tells of its tilt."""
CALIBRATING = 8
"""Rounds in which the noise of the picture's blocks is found."""
AGES = 5
"""Ages of the newest fix over which the output is averaged, evenly between the latency and an interval more."""
SETTLED = 400
"""Fixes after which the filter's gain no longer changes."""


@dataclass(frozen=True, slots=True)
class Flown:
    """How it is flown: height above ground (m), speed (m/s), the camera's leans (roll, pitch in rad) at times that are even over
    the flight, root mean square of the horizontal acceleration (m/s²), fixes a second, and seconds from exposure to answer."""

    height_m: float
    speed_mps: float
    leans_rad: tuple[tuple[float, float], ...]
    acceleration_mps2: float
    fix_rate_hz: float
    latency_s: float


@dataclass(frozen=True, slots=True)
class Stated:
    """1-sigmas that are stated: the map's registration (m), the focal length (a share), the time of frames (s), tilt of mounting
    and attitude together and heading (rad), the matching as fixes claim it, on each axis without the map's share (m), what fixes
    claim on an axis as they weigh in the filter (m; the harmonic mean of the squares), and the camera's half angles of view
    (rad)."""

    map_m: float
    focal_share: float
    time_s: float
    tilt_rad: float
    heading_rad: float
    matching_m: float
    weighed_m: float
    half_view_rad: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Term:
    """A source's name and its 1-sigmas (m) along and across the course."""

    name: str
    along_m: float
    across_m: float


def predicted(flown: Flown, stated: Stated, settings: NavigatorSettings) -> list[Term]:
    """The budget of a flight without GNSS whose fixes come evenly."""
    loop = FilterLoop.of(flown, stated, settings)
    matching_m, propagation_m = loop.shares()
    return [
        Term("map", stated.map_m, stated.map_m),
        calibration(flown, stated.focal_share),
        Term("time", flown.speed_mps * stated.time_s, 0.0),
        tilt(flown, stated),
        heading(flown, stated.heading_rad, loop),
        Term("matching", matching_m, matching_m),
        Term("propagation", propagation_m, propagation_m),
    ]


def total(terms: Sequence[Term]) -> Term:
    """Root of the sum of squares, on each axis."""
    return Term("total", math.hypot(*(t.along_m for t in terms)), math.hypot(*(t.across_m for t in terms)))


def radial_m(term: Term, share: float) -> float:
    """The distance within which a share of the horizontal errors lies.

    Of an elliptical Gaussian (a r cos p, b r sin p), r is Rayleigh's and p even: the share is the mean over p of
    1 - exp(-d^2 / (2 (a^2 cos^2 p + b^2 sin^2 p))).
    """
    angle = (np.arange(ANGLES) + 0.5) * 2 * np.pi / ANGLES
    variance = np.square(term.along_m * np.cos(angle)) + np.square(term.across_m * np.sin(angle))
    low, high = 0.0, 10 * math.hypot(term.along_m, term.across_m)
    if high == 0.0:
        return 0.0
    for _ in range(60):
        middle = (low + high) / 2
        within = float(np.mean(-np.expm1(-(middle**2) / (2 * np.maximum(variance, 1e-300)))))
        low, high = (middle, high) if within < share else (low, middle)
    return high


def calibration(flown: Flown, focal_share: float) -> Term:
    """A lens that is longer by a share makes the vehicle seem lower by that share of the height. What is looked at stays where it
    is: so the position moves by that height times the tangent of the lean (root mean square over the leans flown)."""
    lower_m = flown.height_m * focal_share
    roll, pitch = np.sqrt(np.mean(np.square(np.tan(flown.leans_rad)), axis=0))
    return Term("calibration", lower_m * float(pitch), lower_m * float(roll))


def tilt(flown: Flown, stated: Stated) -> Term:
    """What a wrong tilt moves, as far as the attitude's prior outweighs what the picture shows of it (root mean square over the
    leans flown, errors of roll and pitch independent).

    How much a picture shows depends on its blocks' noise, which is found so that fixes claim, over the leans flown, what they do
    claim: `Stated.weighed_m`.
    """
    noise_m = stated.weighed_m
    for _ in range(CALIBRATING):
        noise_m *= stated.weighed_m / _weighed_m(flown, stated, noise_m)
    moved = [picture_of(*lean, flown.height_m, stated, noise_m).moved_m_per_rad for lean in flown.leans_rad]
    along_m, across_m = stated.tilt_rad * np.sqrt(np.square(moved).sum(2).mean(0))
    return Term("attitude: tilt", float(along_m), float(across_m))


def _weighed_m(flown: Flown, stated: Stated, noise_m: float) -> float:
    """What fixes would claim on an axis with such a noise, as they weigh in the filter."""
    pictures = [picture_of(*lean, flown.height_m, stated, noise_m) for lean in flown.leans_rad]
    return math.sqrt(1 / float(np.mean([2 / np.trace(picture.covariance_m2) for picture in pictures])))


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What the pose that a picture gives is like: its covariance (2, 2) ahead and to the right (m²), and how far (m/rad) it moves
    ahead and to the right (rows) with a prior whose roll and pitch (columns) are wrong, about the camera's own axes."""

    covariance_m2: FloatArray
    moved_m_per_rad: FloatArray


def picture_of(roll_rad: float, pitch_rad: float, height_m: float, stated: Stated, noise_m: float) -> Picture:
    """The pose from a picture of level ground, for a camera that leans, by least squares as localise/pose.py solves for it.

    The blocks are even over the ground. One on the ray (x, y, 1) of the camera, at a depth of D, sees the camera's move dp and
    turn w as f / D (q_x - x q_z, q_y - y q_z) pixels, q = -R' (dp + w x g) with the ground's place g. The noise of all of them
    together is `noise_m` f / D. The prior knows the tilt to `Stated.tilt_rad`; place, height and heading are the picture's.
    """
    tan_side, tan_ahead = (math.tan(half) for half in stated.half_view_rad)
    even = (np.arange(LATTICE) + 0.5) * 2 / LATTICE - 1
    ahead, right = (axis.ravel() for axis in np.meshgrid(tan_ahead * even, tan_side * even))
    (sr, sp), (cr, cp) = np.sin((roll_rad, pitch_rad)), np.cos((roll_rad, pitch_rad))
    R = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    rays = np.column_stack([ahead, right, np.ones_like(ahead)])
    down = rays @ R[2]
    steep = down > np.linalg.norm(rays, axis=1) / math.hypot(1.0, MAX_TAN_INCIDENCE)
    rays, down = rays[steep], down[steep]
    ground = rays @ R.T * (height_m / down)[:, None]
    turned = np.stack([np.cross(axis, ground) @ R for axis in np.eye(3)], axis=2)
    d_q = -np.concatenate([np.broadcast_to(R.T, turned.shape), turned], axis=2)
    J = d_q[:, :2] - rays[:, :2, None] * d_q[:, 2:]
    share = down**-3 / np.sum(down**-3)  # of the ground
    information = np.einsum("n,nij,nik->jk", share, J, J) / noise_m**2
    prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]) / stated.tilt_rad**2
    covariance = np.linalg.inv(information + prior)
    wrong = prior[:, 3:] @ R[:, :2]
    return Picture(covariance[:2, :2], np.asarray((covariance @ wrong)[:2]))


@dataclass(frozen=True, slots=True, eq=False)
class FilterLoop:
    """The position filter between two fixes when its gain K (13, 2) has settled: F, Q (13, 13), H (2, 13) of a fix and what is
    new in each R (2, 2), the share of a fix's variance that is its own and not the map's, and how it is carried to the outputs
    between two fixes: F, Q of each age."""

    F: FloatArray
    Q: FloatArray
    H: FloatArray
    R: FloatArray
    K: FloatArray
    own_share: float
    ages: tuple[tuple[FloatArray, FloatArray], ...]

    @classmethod
    def of(cls, flown: Flown, stated: Stated, settings: NavigatorSettings) -> FilterLoop:
        """Riccati's equation, by going through it; the filter is driven by accelerations (core/filter/propagation.py)."""
        period_s = 1 / flown.fix_rate_hz
        F, Q = _step(period_s, flown, settings)
        P = initial_covariance(settings.seed_sigma_m, settings.velocity_sigma_aiding_mps, settings.acceleration_sigma_mps2)
        H, R = lasting.seen((stated.matching_m**2 + stated.map_m**2) * np.eye(2), "image")
        for _ in range(SETTLED):
            P = F @ P @ F.T + Q
            K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
            P = P - K @ H @ P
            P = np.asarray((P + P.T) / 2, dtype=np.float64)
        ages = tuple(_step(flown.latency_s + (k + 0.5) / AGES * period_s, flown, settings) for k in range(AGES))
        own_share = stated.matching_m**2 / (stated.matching_m**2 + stated.map_m**2)
        return cls(F, Q, H, R, np.asarray(K, dtype=np.float64), own_share, ages)

    def shares(self) -> tuple[float, float]:
        """1-sigma on an axis of the output that the fixes' own errors make, and that the motion between them makes."""
        n = len(self.F)
        keep = np.eye(n) - self.K @ self.H
        lasts = np.zeros((n, n))
        lasts[LASTING, LASTING] = self.Q[LASTING, LASTING]
        of_fixes, of_motion = np.zeros((n, n)), np.zeros((n, n))
        for _ in range(SETTLED):
            of_fixes = keep @ (self.F @ of_fixes @ self.F.T + lasts) @ keep.T + self.K @ self.R @ self.K.T
            of_motion = keep @ (self.F @ of_motion @ self.F.T + self.Q - lasts) @ keep.T
        fixes = np.mean([(F @ of_fixes @ F.T)[0, 0] for F, _ in self.ages])
        motion = np.mean([(F @ of_motion @ F.T + Q)[0, 0] for F, Q in self.ages])
        return math.sqrt(self.own_share * float(fixes)), math.sqrt(float(motion))

    def step_response_m(self) -> float:
        """How far the output is drawn at most when an acceleration is wrong by 1 m/s² from some time on."""
        error, largest = np.zeros(len(self.F)), 0.0
        error[ACCELERATION.start] = 1.0
        for _ in range(SETTLED):
            largest = max(largest, *(abs(float((F @ error)[0])) for F, _ in self.ages))
            error = self.F @ error
            error = error - self.K @ self.H @ error
        return largest


def heading(flown: Flown, heading_rad: float, loop: FilterLoop) -> Term:
    """Fixes find the heading in the picture; the accelerations between them are turned by its error: across the acceleration."""
    drawn_m = loop.step_response_m() * flown.acceleration_mps2 * heading_rad / math.sqrt(2)
    return Term("attitude: heading", drawn_m, drawn_m)


def _step(dt_s: float, flown: Flown, settings: NavigatorSettings) -> tuple[FloatArray, FloatArray]:
    gone_by = flown.speed_mps * dt_s / lasting.apart_m(flown.height_m)
    on = step(dt_s, Drive.INERTIAL, settings.acceleration_sigma_mps2, (0.0, 0.0), settings, gone_by)
    return on.F, on.Q
