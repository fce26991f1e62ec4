"""The turn between two frames from points followed from one to the other, with no belief of it and hardly one of the ground.

The ground is a plane whose normal is known to some degrees, or what a surface model says of it; each point is off that by a
share of the height that is known to no better. Turn (3), displacement over height (3) and slope (2) are solved by Gauss-Newton
with Cauchy weights. A point's departure moves it along its epipolar line only, so a residual counts less in that direction: what
is left is a calibrated homography over flat ground (Faugeras and Lustman 1988) and epipolar geometry over rough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from visloc_companion.types import FloatArray

STEPS, CAUCHY, INLIER = 6, 2.4, 3.5
FIRST_PX, LEAST_PX = 1.0, 0.08
SIGMA_SLOPE, SIGMA_CLIMB = 0.1, 0.03
"""1-sigma of the plane's slope, and of the climb from frame to frame as a share of the height."""
LEAST_RELIEF, FIRST_RELIEF, MOST_RELIEF = 0.01, 0.05, 0.3
"""Of what single points are off the plane, as a share of the height."""
EPIPOLAR_PX = 1.0
"""Where a departure of the whole height moves a point by less, it tells nothing of the relief."""
CLAIM = 1.0
"""Factor on the claimed sigma, fitted on rendered flights (python -m benchmarks.camera_time)."""
TURN, MOVED, SLOPE, UNKNOWNS = slice(0, 3), slice(3, 6), slice(6, 8), 8


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """`R_ba` (3, 3) from the first camera's axes to the second's, its covariance (3, 3) about the second's axes, `moved` (3,) the
    displacement over the height in the first's, the tracks' scatter (pixels), and the share of them that fits."""

    R_ba: FloatArray
    covariance: FloatArray
    moved: FloatArray
    scatter_px: float
    fitting: float


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """Residuals (N, 2), Jacobian (N, 2, 8), and that of a point's departure (N, 2); pixels."""

    r: FloatArray
    J: FloatArray
    g: FloatArray


def solved(
    x_a: FloatArray, xy_b: FloatArray, R_ba: FloatArray, R_ned_a: FloatArray, focal_px: float, nearer: FloatArray | float = 1.0
) -> Turned | None:
    """The turn that fits rays `x_a` (N, 3, third 1) found at `xy_b` (N, 2, normalised), from the start `R_ba`; down is known by
    `R_ned_a`. `nearer` (N,): the camera's height over its height above each point. None where it is undetermined."""
    u, slope = np.zeros(3), np.zeros(2)
    scatter, relief = FIRST_PX, FIRST_RELIEF
    down = R_ned_a[2]
    prior = np.zeros((UNKNOWNS, UNKNOWNS))
    prior[SLOPE, SLOPE] = np.eye(2) / SIGMA_SLOPE**2
    prior[MOVED, MOVED] = np.outer(down, down) / SIGMA_CLIMB**2
    fits, normal = np.ones(len(x_a), np.bool_), prior
    for _ in range(STEPS):
        at = _linearised(x_a, xy_b, R_ba, R_ned_a, u, slope, focal_px, nearer)
        inverse = _weights(at.g, relief, scatter)
        size2 = np.einsum("ni,nij,nj->n", at.r, inverse, at.r)
        weighted = np.matmul(inverse / (1 + size2 / CAUCHY**2)[:, None, None], at.J).reshape(-1, UNKNOWNS)
        fits = size2 < INLIER**2
        normal = at.J.reshape(-1, UNKNOWNS).T @ weighted + prior
        right = weighted.T @ at.r.ravel() - prior @ np.concatenate([np.zeros(3), u, slope])
        try:
            dx = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            return None
        u, slope = u + dx[MOVED], slope + dx[SLOPE]
        R_ba = _rotation(dx[TURN]) @ R_ba
        if fits.sum() >= UNKNOWNS:
            scatter, relief = _spread(at.r - at.J @ dx, at.g, fits)
    covariance = CLAIM**2 * np.linalg.inv(normal)[TURN, TURN]
    if not (np.isfinite(R_ba).all() and np.isfinite(covariance).all()):
        return None
    return Turned(R_ba, np.asarray(covariance, dtype=np.float64), u, scatter, float(fits.mean()))


def _linearised(
    x_a: FloatArray,
    xy_b: FloatArray,
    R_ba: FloatArray,
    R_ned_a: FloatArray,
    u: FloatArray,
    slope: FloatArray,
    focal_px: float,
    nearer: FloatArray | float,
) -> _Linear:
    level = R_ned_a[:2].T
    depth = nearer * (x_a @ R_ned_a[2]) + x_a @ level @ slope
    q = (x_a - depth[:, None] * u) @ R_ba.T
    z = np.maximum(q[:, 2], 1e-3)
    uv = q[:, :2] / z[:, None]
    J_q = np.zeros((len(q), 2, 3))
    J_q[:, 0, 0] = J_q[:, 1, 1] = focal_px / z
    J_q[:, :, 2] = -focal_px * uv / z[:, None]
    J_x = J_q @ R_ba
    J = np.empty((len(q), 2, UNKNOWNS))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        J[:, :, i] = q[:, j, None] * J_q[:, :, k] - q[:, k, None] * J_q[:, :, j]
    J[:, :, MOVED] = -J_x * depth[:, None, None]
    J[:, :, SLOPE] = -(J_x @ u)[:, :, None] * (x_a @ level)[:, None, :]
    return _Linear(focal_px * (xy_b - uv), J, np.matmul(J_x, x_a[:, :, None])[:, :, 0])


def _weights(g: FloatArray, relief: float, scatter: float) -> FloatArray:
    """(N, 2, 2) inverse covariances of the residuals: the tracks' scatter, and the departure along each one's epipolar line."""
    share = 1 / ((scatter / relief) ** 2 + (g**2).sum(1))
    return np.asarray((np.eye(2) - share[:, None, None] * g[:, :, None] * g[:, None, :]) / scatter**2, dtype=np.float64)


def _spread(left: FloatArray, g: FloatArray, fits: NDArray[np.bool_]) -> tuple[float, float]:
    """1-sigma of the tracks (pixels, across their epipolar lines), and of the relief (share of the height, along them)."""
    left, g = left[fits], g[fits]
    length = np.maximum(np.hypot(g[:, 0], g[:, 1]), 1e-9)
    across = np.abs(left[:, 0] * g[:, 1] - left[:, 1] * g[:, 0]) / length
    tells = length > EPIPOLAR_PX
    size = np.where(tells, across, np.hypot(left[:, 0], left[:, 1]) / 1.75)
    scatter = max(LEAST_PX, float(np.median(size)) / 0.6745)
    if not tells.any():
        return scatter, FIRST_RELIEF
    along = np.abs((left * g).sum(1) / length**2)[tells]
    return scatter, float(np.clip(np.median(along) / 0.6745, LEAST_RELIEF, MOST_RELIEF))


def _rotation(turn: FloatArray) -> FloatArray:
    """(3, 3) rotation by a vector (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = turn / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k, dtype=np.float64)
