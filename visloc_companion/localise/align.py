"""Inverse-compositional Lucas-Kanade over the camera's pose, with the map's features as the template.

The frame rectified with a pose p shows F(x) = rho T(x + D(x) delta), where T are the map's features, delta the correction of
the pose and D (2 x 6) the displacement that it causes on the ground. Gradients, steepest-descent images G = grad T D and the
Hessian belong to the map alone (Baker & Matthews 2004). rho, the gain between two dates, is solved for with delta, as in the
enhanced correlation coefficient (Evangelidis & Psarakis 2008): without it a faint likeness shrinks the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from visloc_companion.localise.features.base import Float32Array
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, nadir_offsets
from visloc_companion.types import FloatArray

TEMPLATE_SIGMA_PX = 1.0
DENSE_PIXELS = 20000
"""Larger windows are aligned on every other pixel of every other row: the features are smoother than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """The map's side of the alignment: smoothed features, their gradients per metre north and east (H, W, C)."""

    template: Float32Array
    d_north: Float32Array
    d_east: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One Gauss-Newton step: `delta` (6,) metres north, east, up and radians about north, east, down; its normal equations'
    matrix scaled to information (6, 6); correlation before the step; number of pixels used."""

    delta: FloatArray
    information: FloatArray
    score: float
    n_pixels: float


def prepare(grid: MapGrid) -> Descent:
    """Gradients of the map's features with respect to metres north and east."""
    template = smoothed(grid.features)
    du = cv2.Sobel(template, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dv = cv2.Sobel(template, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    J = np.linalg.inv(grid.A_ne_pix[:, :2]).astype(np.float32)  # pix per metre: columns north, east
    return Descent(template, du * J[0, 0] + dv * J[1, 0], du * J[0, 1] + dv * J[1, 1])


def smoothed(features: Float32Array) -> Float32Array:
    """Features low-passed for a wider basin of convergence."""
    return np.asarray(cv2.GaussianBlur(features, (0, 0), TEMPLATE_SIGMA_PX), dtype=np.float32)


def displacements(grid: MapGrid, pose: CameraPose, stride: int = 1) -> tuple[FloatArray, FloatArray]:
    """(6, H, W) each: metres north and east by which what is seen moves per unit of (north, east, up, w_n, w_e, w_d).

    Rotations are about the NED axes, applied on the left of the attitude.
    """
    height, width = grid.weight.shape
    n, e = nadir_offsets(grid.A_ne_pix, pose.p_ned_m, (width, height))
    n, e = n[::stride, ::stride], e[::stride, ::stride]
    z = np.maximum(np.float32(-pose.p_ned_m[2]) - grid.surface_up_m[::stride, ::stride], np.float32(1.0))
    one, zero = np.ones_like(z), np.zeros_like(z)
    north = np.stack([one, zero, n / z, -n * e / z, z + n * n / z, -e])
    east = np.stack([zero, one, e / z, -z - e * e / z, n * e / z, n])
    return north, east


def gauss_newton_step(
    descent: Descent,
    grid: MapGrid,
    pose: CameraPose,
    frame: Float32Array,
    weight: Float32Array,
    prior_information: FloatArray,
    prior_pull: FloatArray,
    correlated_px: float,
) -> Step:
    """One step from the rectified frame's smoothed features (H, W, C) and the weight (H, W) of both masks.

    `prior_information` (6, 6) and `prior_pull` (6,) are a Gaussian prior's normal equations at this pose.
    `correlated_px`: neighbouring pixels that carry one independent measurement.
    """
    stride = 2 if weight.size > DENSE_PIXELS else 1
    picked = weight[::stride, ::stride] > 0
    w = weight[::stride, ::stride][picked]
    T, F, d_north, d_east = (a[::stride, ::stride][picked] for a in (descent.template, frame, descent.d_north, descent.d_east))
    tt, ft, ff = (float(np.sum(w[:, None] * a * b)) for a, b in ((T, T), (F, T), (F, F)))
    score = ft / max(np.sqrt(tt * ff), 1e-9)
    rho = max(ft / max(tt, 1e-9), 0.05)
    north, east = displacements(grid, pose, stride)
    N, E = north[:, picked], east[:, picked]
    H, b, g_t = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    residual_2 = residual_t = 0.0
    for c in range(T.shape[1]):
        G = N * d_north[:, c] + E * d_east[:, c]
        Gw = G * w
        r = F[:, c] / np.float32(rho) - T[:, c]
        H += Gw @ G.T
        b += Gw @ r
        g_t += Gw @ T[:, c]
        residual_2 += float(np.sum(w * r * r))
        residual_t += float(np.sum(w * r * T[:, c]))
    H -= np.outer(g_t, g_t) / max(tt, 1e-9)
    b -= g_t * (residual_t / max(tt, 1e-9))
    n_pixels = float(w.sum())
    noise = max(residual_2 / max(n_pixels * T.shape[1], 1.0), 1e-6) * correlated_px / stride**2
    information = H / noise
    total = information + prior_information
    damping = np.diag(np.diag(total)) * 1e-6 + np.eye(6) * 1e-9
    delta = np.linalg.solve(total + damping, b / noise + prior_pull)
    return Step(delta, information, score, n_pixels)


def moved(pose: CameraPose, delta: FloatArray) -> CameraPose:
    """The pose after a correction (north, east, up, rotation about north, east, down)."""
    p = pose.p_ned_m + np.array([delta[0], delta[1], -delta[2]])
    R = cv2.Rodrigues(np.asarray(delta[3:6], dtype=np.float64))[0]
    return CameraPose(p, R @ pose.R_ned_cam)


def rotation_between(R_from: FloatArray, R_to: FloatArray) -> FloatArray:
    """(3,) rotation vector w with R_to = exp(w) R_from."""
    return np.asarray(cv2.Rodrigues(R_to @ R_from.T)[0].ravel(), dtype=np.float64)
