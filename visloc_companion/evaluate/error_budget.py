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

from visloc_companion.core.propagation import POSITION, Drive, initial_covariance, transition
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import FloatArray

ANGLES = 720
AGES = 5
"""Ages of the newest fix over which the output is averaged, evenly between the latency and an interval more."""
SETTLED = 400
"""Fixes after which the filter's gain no longer changes."""


@dataclass(frozen=True, slots=True)
class Flown:
    """How it is flown: height above ground (m), speed (m/s), root mean square of the camera's lean forward and to the side (rad)
    and of the horizontal acceleration (m/s²), fixes a second, and seconds from exposure to answer."""

    height_m: float
    speed_mps: float
    pitch_rad: float
    roll_rad: float
    acceleration_mps2: float
    fix_rate_hz: float
    latency_s: float


@dataclass(frozen=True, slots=True)
class Stated:
    """1-sigmas that are stated: the map's registration (m), the focal length (a share), the time of frames (s), tilt of mounting
    and attitude together and heading (rad), the matching as fixes claim it, on each axis without the map's share (m); the
    camera's half angles of view (rad), the blocks that a frame is matched by, and the size of their pixels on the ground (m)."""

    map_m: float
    focal_share: float
    time_s: float
    tilt_rad: float
    heading_rad: float
    matching_m: float
    half_view_rad: tuple[float, float]
    blocks: int
    block_gsd_m: float


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
    is: so the position moves by that height times the tangent of the lean."""
    lower_m = flown.height_m * focal_share
    return Term("calibration", lower_m * math.tan(flown.pitch_rad), lower_m * math.tan(flown.roll_rad))


def tilt(flown: Flown, stated: Stated) -> Term:
    """What a wrong tilt moves: the height times it, as far as the attitude's prior outweighs what the picture shows of it."""
    seen_rad = tilt_seen_rad(flown.height_m, stated)
    prior, seen = stated.tilt_rad**-2, seen_rad**-2
    moved_m = flown.height_m * stated.tilt_rad * prior / (prior + seen)
    return Term("attitude: tilt", moved_m, moved_m)


def tilt_seen_rad(height_m: float, stated: Stated) -> float:
    """1-sigma of the tilt that a nadir picture of level ground shows of itself.

    A tilt of d moves a point at the tangents (x, y) by d (1 + x^2, x y); the constant part looks like a change of place. What is
    left has the mean square var(x^2) + mean(x^2) mean(y^2) over even x and y, and each block tells of it with its own error.
    """
    x2, y2 = (math.tan(half) ** 2 / 3 for half in stated.half_view_rad)
    left = math.tan(stated.half_view_rad[0]) ** 4 * (1 / 5 - 1 / 9) + x2 * y2
    return stated.block_gsd_m / height_m / math.sqrt(stated.blocks * left)


@dataclass(frozen=True, slots=True, eq=False)
class FilterLoop:
    """The position filter between two fixes when its gain K (11, 2) has settled: F, Q (11, 11), the fixes' 1-sigma on an axis,
    and how it is carried to the outputs between two fixes: F, Q of each age."""

    F: FloatArray
    Q: FloatArray
    K: FloatArray
    matching_m: float
    ages: tuple[tuple[FloatArray, FloatArray], ...]

    @classmethod
    def of(cls, flown: Flown, stated: Stated, settings: NavigatorSettings) -> FilterLoop:
        """Riccati's equation, by going through it; the filter is driven by accelerations (core/propagation.py)."""
        period_s = 1 / flown.fix_rate_hz
        F, Q = _step(period_s, settings)
        P = initial_covariance(settings.seed_sigma_m, settings.velocity_sigma_aiding_mps, settings.acceleration_sigma_mps2)
        R = (stated.matching_m**2 + stated.map_m**2) * np.eye(2)
        for _ in range(SETTLED):
            P = F @ P @ F.T + Q
            K = np.linalg.solve(P[POSITION, POSITION] + R, P[POSITION]).T
            P = P - K @ P[POSITION]
            P = np.asarray((P + P.T) / 2, dtype=np.float64)
        ages = tuple(_step(flown.latency_s + (k + 0.5) / AGES * period_s, settings) for k in range(AGES))
        return cls(F, Q, np.asarray(K, dtype=np.float64), stated.matching_m, ages)

    def shares(self) -> tuple[float, float]:
        """1-sigma on an axis of the output that the fixes' own errors make, and that the motion between them makes."""
        n = len(self.F)
        keep = np.eye(n)
        keep[:, POSITION] -= self.K
        of_fixes, of_motion = np.zeros((n, n)), np.zeros((n, n))
        for _ in range(SETTLED):
            of_fixes = keep @ self.F @ of_fixes @ self.F.T @ keep.T + self.matching_m**2 * self.K @ self.K.T
            of_motion = keep @ (self.F @ of_motion @ self.F.T + self.Q) @ keep.T
        fixes = np.mean([(F @ of_fixes @ F.T)[0, 0] for F, _ in self.ages])
        motion = np.mean([(F @ of_motion @ F.T + Q)[0, 0] for F, Q in self.ages])
        return math.sqrt(float(fixes)), math.sqrt(float(motion))

    def step_response_m(self) -> float:
        """How far the output is drawn at most when an acceleration is wrong by 1 m/s² from some time on."""
        error, largest = np.zeros(len(self.F)), 0.0
        error[4] = 1.0
        for _ in range(SETTLED):
            largest = max(largest, *(abs(float((F @ error)[0])) for F, _ in self.ages))
            error = self.F @ error
            error = error - self.K @ error[POSITION]
        return largest


def heading(flown: Flown, heading_rad: float, loop: FilterLoop) -> Term:
    """Fixes find the heading in the picture; the accelerations between them are turned by its error: across the acceleration."""
    drawn_m = loop.step_response_m() * flown.acceleration_mps2 * heading_rad / math.sqrt(2)
    return Term("attitude: heading", drawn_m, drawn_m)


def _step(dt_s: float, settings: NavigatorSettings) -> tuple[FloatArray, FloatArray]:
    F, Q = transition(dt_s, Drive.INERTIAL, np.zeros(1), settings.acceleration_sigma_mps2, (0.0, 0.0), settings)
    return F, np.asarray(Q[0])
