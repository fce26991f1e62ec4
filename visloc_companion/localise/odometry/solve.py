"""The camera's motion from points followed from one frame to another, with what the autopilot knows as Gaussian terms.

Unknowns: the displacement (3), the second frame's turn against the first beyond the autopilot's (3), both frames' common error of
tilt (2), the ground's level and slope (3), what is wrong with a rangefinder and with the altitude all the time, and one
departure from that ground for each point. Departures are shares of the height: in metres, a world that is smaller than it is
would cost less, and shrink. They are eliminated one by one (a point's departure moves it along its ray only), Gauss-Newton does
the rest, with Cauchy weights. What is left of the ambiguities (a turn against a shift, the scale against the height) is in the
covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.pinhole import projected
from visloc_companion.localise.pose import LEAST_SIGMA
from visloc_companion.types import FloatArray

D, TURN, TILT, LEVEL, SLOPE, RANGE, UP = slice(0, 3), slice(3, 6), slice(6, 8), 8, slice(9, 11), 11, 12
UNKNOWNS = 13
COMMON = [6, 7, RANGE, UP]
"""Unknowns that are the same for neighbouring legs."""
STEPS = 9
CAUCHY = 2.4
INLIER = 3.5
"""Sigmas of a track's residual up to which it counts as fitting."""
EVEN_M, PATCH_SHARE = 2.4, 0.5
"""A rangefinder meets gaps in a wood, the picture around them is of crowns: so much of a roughness beyond the first."""
LEAST_PX = 0.08
LEAST_M = 1e-3
FIRST_PX = 2.0
"""Width that the tracks' scatter is taken for in the first steps, so that a poor start loses no right ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Points in the keyframe: `at_ned_m` (N, 3) from its camera, where rays meet the ground as it is believed to be, and the
    1-sigma `spread_m` (N,) of each one's own height; those that a rangefinder measured are `ranged` (N,). `level_m` and
    `slope_rad` are the 1-sigma of what the others share here, `sigma_up_m` of what they share everywhere, `sigma_range_m` of the
    rangefinder's. `readings` (M, 3): north, east, and how far below the believed ground a height that was read has it, each with
    `reading_m`. `coarse`: of a surface model that does not know the land between its samples, as nor do the sigmas."""

    at_ned_m: FloatArray
    spread_m: FloatArray
    ranged: NDArray[np.bool_]
    level_m: float
    slope_rad: float
    sigma_up_m: float
    sigma_range_m: float = 0.0
    readings: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    reading_m: float = 1.0
    readings_ranged: bool = False
    coarse: bool = False

    def at(self, number: NDArray[np.intp]) -> Ground:
        """The ground at some of its points."""
        return replace(self, at_ned_m=self.at_ned_m[number], spread_m=self.spread_m[number], ranged=self.ranged[number])

    def rougher(self, by: float) -> Ground:
        """The ground with the sigmas of what its points depart by, each and together, larger by a factor."""
        return replace(self, spread_m=self.spread_m * by, level_m=self.level_m * by, slope_rad=self.slope_rad * by)


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """What is believed of the second frame: attitude (3, 3), start of the search for the displacement (3,), climb (down, m); and
    the keyframe's optical axis (3,)."""

    R_ned_cam: FloatArray
    start_ned_m: FloatArray
    down_m: float
    sigma_turn_rad: float
    sigma_tilt_rad: float
    sigma_climb_m: float
    key_axis_ned: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Displacement (3,) with covariance (3, 3), heading's error left out; `shared` (3, 3) is the part of it that neighbouring
    legs share (heights, tilt). `fits` (N,) says which tracks fit, `scatter_px` how well; `roughness` is the rms departure of
    points from the ground in their sigmas; `turn_rad` (3,) the correction of the attitude; `by_lens_m` (3,) by how much the
    displacement comes out too long for each share by which the lens is longer than calibrated."""

    d_ned_m: FloatArray
    covariance: FloatArray
    shared: FloatArray
    fits: NDArray[np.bool_]
    scatter_px: float
    roughness: float
    turn_rad: FloatArray
    by_lens_m: FloatArray


def solve(ground: Ground, xy: FloatArray, prior: MotionPrior, focal_px: float) -> Motion | None:
    """The motion that fits (N, 2) normalised coordinates in the second frame best; None where it is undetermined."""
    x = np.zeros(UNKNOWNS)
    x[D] = prior.start_ned_m
    departure = np.zeros(len(xy))
    information = _information(ground, prior)
    scatter, normal = FIRST_PX, np.eye(UNKNOWNS)
    fits, weighted = np.ones(len(xy), np.bool_), np.zeros((len(xy), 2, UNKNOWNS))
    for step in range(STEPS):
        residual, J, g, ahead = _linearised(ground, x, departure, xy, prior, focal_px)
        residual = residual + g * departure[:, None]
        inverse = _weights(g, ground.spread_m, scatter)
        size2 = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        weight = np.where(ahead, 1 / (1 + size2 / CAUCHY**2), 0.0)
        fits = ahead & (size2 < INLIER**2)
        weighted = np.einsum("nij,njk->nik", inverse * weight[:, None, None], J)
        normal = np.einsum("nij,nik->jk", J, weighted) + information
        right = np.einsum("nij,ni->j", weighted, residual) - information @ x
        _add_terms(normal, right, ground, prior, x)
        dx = _solved(normal, right)
        if dx is None:
            return None
        left = residual - J @ dx
        departure = ground.spread_m**2 * np.einsum("ni,nij,nj->n", g, inverse, left)
        x = x + dx
        information[RANGE, RANGE] = 1 / (ground.sigma_range_m**2 + _patches_m(ground, departure, fits) ** 2 + LEAST_M**2)
        if step > 1:
            scatter = _scatter(left - g * departure[:, None], g, fits)
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    by_lens = -covariance @ np.einsum("nij,ni->j", weighted, _by_lens(ground, J, xy, prior.key_axis_ned, focal_px))
    return _motion(x, covariance, by_lens, fits, scatter, departure / ground.spread_m)


def _by_lens(ground: Ground, J: FloatArray, xy: FloatArray, key_axis_ned: FloatArray, focal_px: float) -> FloatArray:
    """(N, 2) derivative of the residuals by the share by which a lens is longer than calibrated: what is measured in the second
    frame, and where the keyframe's rays meet the ground, are that much too far from the optical axis."""
    at = ground.at_ned_m
    off_axis = at - (at @ key_axis_ned)[:, None] * key_axis_ned
    met = at * (off_axis[:, 2:3] / at[:, 2:3]) - off_axis
    return np.asarray(np.einsum("nij,nj->ni", J[:, :, D], met) - focal_px * xy, dtype=np.float64)


def _patches_m(ground: Ground, departure: FloatArray, fits: NDArray[np.bool_]) -> float:
    """1-sigma of the mean height by which the pictures around measured points stand off these, where the ground is rough."""
    own = departure[fits & ~ground.ranged]
    rough = float(np.sqrt(np.mean(own**2))) if len(own) else 0.0
    return PATCH_SHARE * max(0.0, rough - EVEN_M)


def _information(ground: Ground, prior: MotionPrior) -> FloatArray:
    sigma = np.full(UNKNOWNS, np.inf)
    sigma[TURN], sigma[TILT], sigma[LEVEL] = prior.sigma_turn_rad, max(prior.sigma_tilt_rad, LEAST_SIGMA), ground.level_m
    sigma[SLOPE] = ground.slope_rad
    sigma[RANGE], sigma[UP] = max(ground.sigma_range_m, LEAST_M), max(ground.sigma_up_m, LEAST_M)
    return np.diag(1 / sigma**2)


def _linearised(
    ground: Ground, x: FloatArray, departure: FloatArray, xy: FloatArray, prior: MotionPrior, focal_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Measured less predicted (N, 2) pixels, Jacobian (N, 2, 13), that of a point's departure (N, 2), and what lies ahead."""
    along = ground.at_ned_m / ground.at_ned_m[:, 2:3]
    ne = ground.at_ned_m[:, :2]
    tilt, plain = x[TILT], 1.0 - ground.ranged
    share = ground.at_ned_m[:, 2] / np.median(ground.at_ned_m[:, 2])
    grown = 1 + plain * (x[LEVEL] + x[UP]) * share / ground.at_ned_m[:, 2]
    lower = departure * grown + ne @ np.array([tilt[1], -tilt[0]])
    lower += plain * ((x[LEVEL] + x[UP]) * share + ne @ x[SLOPE]) + ground.ranged * x[RANGE]
    r = ground.at_ned_m + along * lower[:, None] - x[D]
    R = _turned(x[TURN]) @ prior.R_ned_cam
    q = r @ R
    uv, J_q, ahead = projected(q, focal_px)
    J_r = J_q @ R.T
    J = np.zeros((len(r), 2, UNKNOWNS))
    J[:, :, D] = -J_r
    J[:, :, TURN] = np.einsum("nij,nkj->nik", J_r, np.cross(r[:, None, :], np.eye(3)[None]))
    g = np.einsum("nij,nj->ni", J_r, along)
    J[:, :, LEVEL] = J[:, :, UP] = g * (plain * share * (1 + departure / ground.at_ned_m[:, 2]))[:, None]
    J[:, :, RANGE] = g * ground.ranged[:, None]
    J[:, :, SLOPE] = (g * plain[:, None])[:, :, None] * ne[:, None, :]
    J[:, :, TILT] = g[:, :, None] * (ne[:, ::-1] * [-1.0, 1.0])[:, None, :]
    return focal_px * (xy - uv), J, g * grown[:, None], ahead


def _weights(g: FloatArray, spread: FloatArray, scatter: float) -> FloatArray:
    """(N, 2, 2) inverse covariances of the residuals: the tracks' scatter, and the departure along each one's epipolar line."""
    share = 1 / ((scatter / np.maximum(spread, 1e-6)) ** 2 + (g**2).sum(1))
    return np.asarray((np.eye(2) - share[:, None, None] * g[:, :, None] * g[:, None, :]) / scatter**2, dtype=np.float64)


def _add_terms(normal: FloatArray, right: FloatArray, ground: Ground, prior: MotionPrior, x: FloatArray) -> None:
    """The climb (true down is that of the tilted axes turned back), and the heights read on the way; in place."""
    row = np.zeros(UNKNOWNS)
    row[2], row[TILT] = 1.0, (x[1], -x[0])
    row[:2] = -x[TILT][1], x[TILT][0]
    level = x[2] + x[6] * x[1] - x[7] * x[0]
    _add(normal, right, row, (prior.down_m - level), prior.sigma_climb_m)
    for north, east, lower in ground.readings:
        row = np.zeros(UNKNOWNS)
        row[LEVEL], row[SLOPE], row[RANGE] = 1.0, (north, east), -1.0 * ground.readings_ranged
        row[UP] = 1.0 * ground.readings_ranged
        _add(normal, right, row, lower - float(row @ x), ground.reading_m)


def _add(normal: FloatArray, right: FloatArray, row: FloatArray, deviation: float, sigma: float) -> None:
    normal += np.outer(row, row) / sigma**2
    right += row * (deviation / sigma**2)


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray | None:
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1e12:
        return None
    return np.asarray(scale * np.linalg.solve(scaled, scale * right), dtype=np.float64)


def _scatter(left: FloatArray, g: FloatArray, fits: NDArray[np.bool_]) -> float:
    """1-sigma of the tracks across their epipolar lines, where the ground has no say."""
    length = np.hypot(g[:, 0], g[:, 1])
    across = np.abs(left[:, 0] * g[:, 1] - left[:, 1] * g[:, 0]) / np.maximum(length, 1e-9)
    size = np.where(length > 1e-3, across, np.hypot(left[:, 0], left[:, 1]) / 1.75)
    return max(LEAST_PX, float(np.median(size[fits])) / 0.6745) if fits.any() else FIRST_PX


def _motion(
    x: FloatArray, covariance: FloatArray, by_lens: FloatArray, fits: NDArray[np.bool_], scatter: float, departure: FloatArray
) -> Motion:
    """The displacement in level axes, and its covariance with the part that the heights and the tilt make."""
    tilt = np.array([*x[TILT], 0.0])
    J = np.zeros((3, UNKNOWNS))
    J[:, D] = np.eye(3) + _cross(tilt)
    J[:, TILT] = -_cross(x[D])[:, :2]
    toward = J @ covariance[:, COMMON]
    shared = toward @ np.linalg.inv(covariance[np.ix_(COMMON, COMMON)]) @ toward.T
    rough = float(np.sqrt(np.mean(departure[fits] ** 2))) if fits.any() else 0.0
    return Motion(J[:, D] @ x[D], J @ covariance @ J.T, shared, fits, scatter, rough, x[TURN], J @ by_lens)


def _turned(turn: FloatArray) -> FloatArray:
    """(3, 3) rotation by a small vector (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.eye(3)
    k = _cross(turn / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k, dtype=np.float64)


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
