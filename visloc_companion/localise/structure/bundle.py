"""Bundle adjustment of a few frames: poses and tracked points, with what autopilot and odometry believe as Gaussian terms.

Gauss-Newton with the points eliminated (Schur complement; Triggs et al. 2000, section 6), Cauchy weights whose scale is narrowed
from coarse to fine, so that wrong tracks lose their say before the rest settles. Unknowns of a pose: position (east, north, up)
and a rotation vector about these axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.pinhole import projected
from visloc_companion.localise.structure.tracks import Tracks
from visloc_companion.types import FloatArray

SCALES_PX = (16.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0)
"""Width of the Cauchy weights, one Gauss-Newton step each; after the first its least is CAUCHY times the tracks' scatter."""
CAUCHY = 2.4
INLIER_PX = 1.5
WEAKEST = 1e-9
"""Information a point has at least along its ray, relative to that across: far points stay where they are."""


@dataclass(frozen=True, slots=True, eq=False)
class PosePriors:
    """(F, 4, 4) T_local_cam and (F, 6) 1-sigma of position (m) and rotation about east, north, up (radians)."""

    T_local_cam: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Refined poses (F, 4, 4) with covariance (6F, 6F), points (M, 3) and which of them are well seen (M,), scatter in pixels.

    `chi2` is the mean squared deviation of the poses from their priors in sigmas.
    """

    T_local_cam: FloatArray
    covariance: FloatArray
    points: FloatArray
    good: NDArray[np.bool_]
    scatter_px: float
    chi2: float

    def of(self, frames: Sequence[int]) -> Bundle:
        """With these of its frames alone."""
        at = (6 * np.array(frames)[:, None] + np.arange(6)).ravel()
        return replace(self, T_local_cam=self.T_local_cam[list(frames)], covariance=self.covariance[np.ix_(at, at)])


def adjust(tracks: Tracks, priors: PosePriors, focal_px: float, sigma_px: float) -> Bundle | None:
    """Poses and points that fit tracks and priors best; None where that is undetermined."""
    T = priors.T_local_cam.copy()
    points = _triangulated(tracks, T)
    information = np.diag((1 / priors.sigma**2).ravel())
    normal, residual = information, np.zeros((len(tracks.xy), 2))
    scatter = sigma_px
    for step, width in enumerate(SCALES_PX):
        residual, J_pose, J_point, ahead = _linearised(tracks, T, points, focal_px)
        size = np.hypot(residual[:, 0], residual[:, 1])
        scatter = max(sigma_px, float(np.median(size[ahead])) / 1.1774) if ahead.any() else sigma_px
        scale = width if step == 0 else max(width, CAUCHY * scatter)
        weight = np.where(ahead, 1 / (1 + (size / scale) ** 2), 0.0) / scatter**2
        solved = _step(tracks, residual, J_pose, J_point, weight, information, _deviation(T, priors))
        if solved is None:
            return None
        normal, d_pose, d_point = solved
        points = points + d_point
        for k, d in enumerate(d_pose):
            T[k, :3, 3] += d[:3]
            T[k, :3, :3] = cv2.Rodrigues(d[3:])[0] @ T[k, :3, :3]
    residual, _, _, ahead = _linearised(tracks, T, points, focal_px)
    size = np.where(ahead, np.hypot(residual[:, 0], residual[:, 1]), np.inf)
    worst = np.zeros(len(points))
    np.maximum.at(worst, tracks.point, size)
    chi2 = float(((_deviation(T, priors) / priors.sigma) ** 2).mean())
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return Bundle(T, covariance, points, worst < max(INLIER_PX, 3 * scatter), scatter, chi2)


def rotation_only_px(tracks: Tracks, partner: int, focal_px: float) -> float:
    """Median distance, pixels, that is left between the hub's and a partner's rays when the ones are merely turned."""
    point_h, xy_h = tracks.of(0)
    point_p, xy_p = tracks.of(partner)
    a, b = (np.column_stack([xy, np.ones(len(xy))]) for xy in (xy_h[np.searchsorted(point_h, point_p)], xy_p))
    a, b = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (a, b))
    weight, apart = np.ones(len(a)), np.zeros(len(a))
    for _ in range(6):
        u, _, vt = np.linalg.svd((a * weight[:, None]).T @ b)
        turn = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
        apart = np.linalg.norm(b - a @ turn.T, axis=1) * focal_px
        weight = 1 / (1 + (apart / 2.0) ** 2)
    return float(np.median(apart))


def _triangulated(tracks: Tracks, T: FloatArray) -> FloatArray:
    """(M, 3) points nearest to their rays."""
    d = np.einsum("oij,oj->oi", T[tracks.frame, :3, :3], np.column_stack([tracks.xy, np.ones(len(tracks.xy))]))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    n = int(tracks.point.max()) + 1
    A, b = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(A, tracks.point, across)
    np.add.at(b, tracks.point, np.einsum("oij,oj->oi", across, T[tracks.frame, :3, 3]))
    return np.asarray(np.linalg.solve(A + 1e-12 * np.eye(3), b[..., None])[..., 0], dtype=np.float64)


def _linearised(
    tracks: Tracks, T: FloatArray, points: FloatArray, focal_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Measured minus predicted (O, 2) pixels, Jacobians (O, 2, 6) of the pose and (O, 2, 3) of the point, and what lies ahead."""
    R, r = T[tracks.frame, :3, :3], points[tracks.point] - T[tracks.frame, :3, 3]
    q = np.einsum("oji,oj->oi", R, r)
    uv, J_q, ahead = projected(q, focal_px)
    J_point = np.einsum("oij,okj->oik", J_q, R)
    turned = np.cross(r[:, None, :], np.eye(3)[None])  # d q = R^T (r x w): rows r x e_k
    J_pose = np.concatenate([-J_point, np.einsum("oij,okj->oik", J_point, turned)], axis=2)
    return focal_px * (tracks.xy - uv), J_pose, J_point, ahead


def _deviation(T: FloatArray, priors: PosePriors) -> FloatArray:
    """(F, 6) of the poses from their priors."""
    turn = [cv2.Rodrigues(R @ R0.T)[0].ravel() for R, R0 in zip(T[:, :3, :3], priors.T_local_cam[:, :3, :3], strict=True)]
    return np.hstack([T[:, :3, 3] - priors.T_local_cam[:, :3, 3], np.array(turn)])


def _by_pose(blocks: FloatArray) -> FloatArray:
    """(M, F, 6, 3) as (6F, 3M)."""
    m, f = blocks.shape[:2]
    return blocks.transpose(1, 2, 0, 3).reshape(6 * f, 3 * m)


def _step(
    tracks: Tracks,
    residual: FloatArray,
    J_pose: FloatArray,
    J_point: FloatArray,
    weight: FloatArray,
    information: FloatArray,
    deviation: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Reduced normal matrix (6F, 6F), steps (F, 6) of the poses and (M, 3) of the points."""
    f, m = len(deviation), int(tracks.point.max()) + 1
    weighted_pose, weighted_point = J_pose * weight[:, None, None], J_point * weight[:, None, None]
    U, V, W = np.zeros((f, 6, 6)), np.zeros((m, 3, 3)), np.zeros((m, f, 6, 3))
    g_pose, g_point = np.zeros((f, 6)), np.zeros((m, 3))
    np.add.at(U, tracks.frame, np.einsum("oij,oik->ojk", weighted_pose, J_pose))
    np.add.at(V, tracks.point, np.einsum("oij,oik->ojk", weighted_point, J_point))
    np.add.at(W, (tracks.point, tracks.frame), np.einsum("oij,oik->ojk", weighted_pose, J_point))
    np.add.at(g_pose, tracks.frame, np.einsum("oij,oi->oj", weighted_pose, residual))
    np.add.at(g_point, tracks.point, np.einsum("oij,oi->oj", weighted_point, residual))
    V += (WEAKEST * np.trace(V, axis1=1, axis2=2) + 1e-9)[:, None, None] * np.eye(3)
    V_inverse = np.linalg.inv(V)
    WV = np.einsum("mfij,mjk->mfik", W, V_inverse)
    S = information - _by_pose(WV) @ _by_pose(W).T
    for k in range(f):
        S[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += U[k]
    right = (g_pose - np.einsum("mfij,mj->fi", WV, g_point)).ravel() - information @ deviation.ravel()
    scaled = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    if not np.isfinite(S).all() or np.linalg.cond(S * np.outer(scaled, scaled)) > 1e13:
        return None
    d_pose = np.linalg.solve(S, right).reshape(f, 6)
    d_point = np.einsum("mij,mj->mi", V_inverse, g_point - np.einsum("mfij,fi->mj", W, d_pose))
    return S, d_pose, d_point
