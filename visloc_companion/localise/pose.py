"""The camera's pose from correspondences of ground points and frame pixels, with the tilt as a Gaussian prior.

Gauss-Newton on the reprojection error with Cauchy weights (iteratively reweighted). Unknowns: north, east, up and a rotation
vector about the NED axes. The prior knows roll and pitch (from gravity), not the heading, not the position.

Ground that leans looks like a camera that tilts (ground.py). Where the slope is open, what is solved for is the apparent pose,
with a prior as much wider; the true one differs by a turn about the ground looked at, of which prior and slope each explain
their share. Slope and tilt differ in the second order only, and no real ground is so much of a plane that this tells them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from visloc_companion.localise.align import moved
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.types import FloatArray

CAUCHY = 2.0
SIGMA_FLOOR = 0.8
"""Least scatter that is believed (in the given sigmas): errors that neighbouring blocks share, of surface model and map, do not
show in their differences."""
LEAST_SIGMA = 1e-5
"""Of a prior's term (m, rad); nothing is known better."""
LEAST_TOLD = 1e-6
"""Share of the tilt's variance about an axis that points take away, where they tell nothing of it."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """Pose, covariance (6, 6) of (north, east, up, rotation about n, e, d), scatter of the residuals (in units of the given
    sigmas; the largest of several channels), the final weights (N,) of the correspondences, by how much (6,) the pose is off per
    share of the focal length by which the lens is longer than the model has it. Of the prior that it was solved with: the 1-sigma
    of the tilt, and how many sigmas what the points show of it is from that, their own uncertainty included."""

    pose: CameraPose
    covariance: FloatArray
    scatter: float
    weights: FloatArray
    per_focal: FloatArray
    sigma_tilt_rad: float
    tilt_sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class PriorTerm:
    """Gaussian prior of the attitude (tilt always, heading where `sigma_yaw_rad` is finite) and of the height."""

    R_ned_cam: FloatArray
    sigma_tilt_rad: float
    sigma_yaw_rad: float = math.inf
    up_m: float = 0.0
    sigma_up_m: float = math.inf

    def at(self, pose: CameraPose) -> tuple[FloatArray, FloatArray]:
        """Information (6, 6) and pull (6,) of the prior's normal equations at a pose."""
        heading, tilt = heading_and_tilt(pose.R_ned_cam, self.R_ned_cam)
        deviation = np.array([0.0, 0.0, -pose.p_ned_m[2] - self.up_m, tilt[0], tilt[1], heading])
        sigma = np.array([math.inf, math.inf, self.sigma_up_m, self.sigma_tilt_rad, self.sigma_tilt_rad, self.sigma_yaw_rad])
        weight = 1 / np.maximum(sigma, LEAST_SIGMA) ** 2
        return np.diag(weight), -weight * deviation


def widened(prior: PriorTerm, sigma_slope_rad: float) -> PriorTerm:
    """The prior of the apparent pose over ground of unknown slope (1-sigma on each axis)."""
    return replace(prior, sigma_tilt_rad=math.hypot(prior.sigma_tilt_rad, sigma_slope_rad))


def freed_of_slope(apparent: PoseEstimate, prior: PriorTerm, sigma_slope_rad: float, ground_up_m: float) -> PoseEstimate:
    """The true pose and its covariance from the apparent one, which was solved for with the widened prior.

    Of the apparent tilt's distance from the prior's, the slope explains the share of its variance; what stays open of it is
    added to the covariance, with what it moves the position by.
    """
    if sigma_slope_rad <= 0:
        return apparent
    slope_2, tilt_2 = sigma_slope_rad**2, prior.sigma_tilt_rad**2
    share = slope_2 / (slope_2 + tilt_2)
    _, tilt = heading_and_tilt(apparent.pose.R_ned_cam, prior.R_ned_cam)
    turn = _turns_about_view(apparent.pose, ground_up_m)
    kept = np.eye(6)
    kept[:, 3:5] -= share * turn
    covariance = np.asarray(kept @ apparent.covariance @ kept.T + share * tilt_2 * turn @ turn.T, dtype=np.float64)
    pose = turned_about_view(apparent.pose, ground_up_m, np.append(-share * tilt, 0.0))
    per_focal = np.asarray(kept @ apparent.per_focal)
    return replace(apparent, pose=pose, covariance=covariance, per_focal=per_focal, sigma_tilt_rad=prior.sigma_tilt_rad)


def turned_about_view(pose: CameraPose, ground_up_m: float, turn_rad: FloatArray) -> CameraPose:
    """The pose turned (rotation vector about north, east, down) about the ground that the camera's axis meets."""
    arm = to_view(pose, ground_up_m)
    turned = moved(pose, np.concatenate([np.zeros(3), turn_rad]))
    return CameraPose(pose.p_ned_m + arm - turned.R_ned_cam @ pose.R_ned_cam.T @ arm, turned.R_ned_cam)


def _turns_about_view(pose: CameraPose, ground_up_m: float) -> FloatArray:
    """(6, 2) change of north, east, up and rotation by a turn about north and about east around the ground looked at."""
    arm = to_view(pose, ground_up_m)
    columns = [np.append(-np.cross(axis, arm) * (1, 1, -1), axis) for axis in np.eye(3)[:2]]
    return np.column_stack(columns)


def to_view(pose: CameraPose, ground_up_m: float) -> FloatArray:
    """(3,) from the camera to the ground that its axis meets; no flatter than 1 in 5."""
    axis = pose.R_ned_cam[:, 2]
    return np.asarray(axis * (max(1.0, -float(pose.p_ned_m[2]) - ground_up_m) / max(float(axis[2]), 0.2)))


def heading_and_tilt(R_ned_cam: FloatArray, R_prior: FloatArray) -> tuple[float, FloatArray]:
    """How an attitude differs from the prior's: turn about the vertical, and then (2,) rotation about north and east."""
    relative = R_ned_cam @ R_prior.T
    heading = _about_vertical(relative)
    s, c = math.sin(heading), math.cos(heading)
    tilt = cv2.Rodrigues(relative @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))[0].ravel()
    return heading, np.asarray(tilt[:2], dtype=np.float64)


def heading_from(R_ned_cam: FloatArray, R_prior: FloatArray) -> float:
    """The turn about the vertical alone: what most ask for, at a third of the work."""
    return _about_vertical(R_ned_cam @ R_prior.T)


def _about_vertical(relative: FloatArray) -> float:
    return math.atan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])


def solve_pose(
    ground_ned_m: FloatArray,
    pix: FloatArray,
    sigma_px: FloatArray,
    K: FloatArray,
    start: CameraPose,
    prior: PriorTerm,
    iterations: int = 8,
    heights_m2: FloatArray | None = None,
    worth: FloatArray | None = None,
    cauchy: float = CAUCHY,
    widening: Callable[[float], float] | None = None,
    whitening: FloatArray | None = None,
    channel: NDArray[np.int64] | None = None,
) -> PoseEstimate | None:
    """Pose from (N, 3) ground points and (N, 2) undistorted pixels of a pinhole camera, or None where it is undetermined.

    The covariance is scaled by the residuals' robust scatter where that is larger than what the sigmas claim. The points' heights
    may err with a covariance `heights_m2` (N, N); what that leaves open of the pose is in its covariance, unscaled. `worth` (N,)
    is the share of each point's information that counts; a point `cauchy` scatters off counts half. `widening`: by how much the
    points' sigmas are larger than they show themselves to be, at a scatter; what the prior knows is as well known as it says.
    `whitening` (N, 2, 2) turns what a point is off by (pixels) into a vector as uncertain along all axes, `sigma_px` on each.
    Points of each `channel` (N,) have a scatter of their own.
    """
    pose, weights, scatter = start, np.ones(len(pix)), np.ones(len(pix))
    counts = np.ones(len(pix)) if worth is None else worth
    channels = [np.ones(len(pix), dtype=np.bool_)] if channel is None else [channel == one for one in np.unique(channel)]
    if len(pix) < 3:
        return None
    normal, by_focal, lower_m = np.eye(6), np.zeros(6), np.zeros(len(pix))
    from_centre = pix - np.array([K[0, 2], K[1, 2]])
    if whitening is not None:
        from_centre = np.einsum("nij,nj->ni", whitening, from_centre)
    for _ in range(iterations):
        residual, J = _residuals(ground_ned_m, pix, K, pose)
        if residual is None:
            return None
        if whitening is not None:
            residual, J = np.einsum("nij,nj->ni", whitening, residual), whitening @ J
        whitened = np.hypot(*(residual - J[:, :, 2] * lower_m[:, None]).T) / sigma_px
        scatter, factor = _scatters(whitened, channels, widening)
        weights = 1 / (1 + (whitened / (cauchy * scatter)) ** 2)
        w = (weights * counts / (sigma_px * scatter * factor) ** 2)[:, None]
        information, pull = prior.at(pose)
        normal = np.einsum("nij,nik->jk", J * w[..., None], J) + information
        both = np.stack([residual, from_centre], axis=2)
        pulls = np.einsum("nij,nik->jk", J * w[..., None], both) + np.column_stack([pull, np.zeros(6)])
        together, by_pose_m, seen_m = _heights_open(both, J, w[:, 0], heights_m2)
        normal, pulls = normal - together.T @ by_pose_m, pulls - together.T @ seen_m
        if np.linalg.cond(_scaled(normal)) > 1e12:
            return None
        delta, by_focal = np.linalg.solve(normal, pulls).T
        pose, lower_m = moved(pose, delta), seen_m[:, 0] - by_pose_m @ delta
        if abs(delta[:3]).max() < 1e-4:
            break
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    tilt_sigmas = _tilt_sigmas(pose, covariance, prior)
    return PoseEstimate(pose, covariance, float(scatter.max()), weights, by_focal, prior.sigma_tilt_rad, tilt_sigmas)


def _scatters(
    whitened: FloatArray, channels: Sequence[NDArray[np.bool_]], widening: Callable[[float], float] | None
) -> tuple[FloatArray, FloatArray]:
    """Robust scatter (N,) of the residuals (N,) of each point's channel, in their sigmas, and the factor of `widening` at it.

    `channels`: which points (N,) belong to each.
    """
    scatter, factor = np.ones(len(whitened)), np.ones(len(whitened))
    for own in channels:
        n = int(own.sum())
        of_own = max(SIGMA_FLOOR, 1.1774**-1 * float(np.median(whitened[own])) * math.sqrt(n / max(1.0, n - 2.0)))
        scatter[own] = of_own
        if widening is not None:
            factor[own] = widening(of_own)
    return scatter, factor


def _tilt_sigmas(pose: CameraPose, covariance: FloatArray, prior: PriorTerm) -> float:
    """Root of chi-squared, of two degrees of freedom where points and prior err as they claim.

    Points that move the tilt away from the prior's make it surer as well: by how far they move it has the prior's covariance less
    the answer's.
    """
    sigma = max(prior.sigma_tilt_rad, LEAST_SIGMA)
    told, axes = np.linalg.eigh(np.eye(2) - covariance[3:5, 3:5] / sigma**2)
    _, tilt = heading_and_tilt(pose.R_ned_cam, prior.R_ned_cam)
    return float(np.linalg.norm(axes.T @ tilt / sigma / np.sqrt(np.maximum(told, LEAST_TOLD))))


def _heights_open(
    residuals: FloatArray, J: FloatArray, w: FloatArray, heights_m2: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What heights that are not known take from the normal equations: they are unknowns of their own, one for each point, with a
    prior of covariance (N, N), and are solved for first (Schur complement).

    Returns the terms that they share with the pose (N, 6), by how much they would be lower for each unit of the pose (N, 6), and
    by how much each of K residuals (N, 2, K) has them lower (N, K). A point that lies lower is seen as from a camera that much
    higher.
    """
    n = len(residuals)
    if heights_m2 is None:
        return np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, residuals.shape[2]))
    of_pose_and_seen = np.concatenate([J, residuals], axis=2)
    terms = (J[:, :, 2, None] * of_pose_and_seen).sum(axis=1) * w[:, None]
    known = np.eye(n) + heights_m2 * terms[:, 2]
    solved = np.linalg.solve(known, heights_m2 @ terms)
    return terms[:, :6], solved[:, :6], solved[:, 6:]


def _residuals(
    ground_ned_m: FloatArray, pix: FloatArray, K: FloatArray, pose: CameraPose
) -> tuple[FloatArray | None, FloatArray]:
    """Measured minus predicted pixels (N, 2) and their Jacobian (N, 2, 6); None where a point is not before the camera."""
    r = ground_ned_m - pose.p_ned_m
    q = r @ pose.R_ned_cam
    if (q[:, 2] < 1e-3).any():
        return None, np.zeros((0, 2, 6))
    uv = q[:, :2] / q[:, 2:3]
    predicted = uv * np.array([K[0, 0], K[1, 1]]) + np.array([K[0, 2], K[1, 2]])
    d_q = np.zeros((len(r), 2, 3))
    d_q[:, 0, 0], d_q[:, 1, 1] = K[0, 0] / q[:, 2], K[1, 1] / q[:, 2]
    d_q[:, 0, 2], d_q[:, 1, 2] = -K[0, 0] * uv[:, 0] / q[:, 2], -K[1, 1] * uv[:, 1] / q[:, 2]
    d_r = d_q @ pose.R_ned_cam.T  # per metre of r in NED
    J = np.empty((len(r), 2, 6))
    J[:, :, 0], J[:, :, 1], J[:, :, 2] = -d_r[:, :, 0], -d_r[:, :, 1], d_r[:, :, 2]
    # q = (exp(w) R)^T r = R^T (r - w x r): d q = R^T (r x w) -> columns r x e_k (np.cross takes as long as all the rest)
    for k, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        J[:, :, 3 + k] = d_r[:, :, a] * r[:, None, b] - d_r[:, :, b] * r[:, None, a]
    return pix - predicted, J


def _scaled(normal: FloatArray) -> FloatArray:
    d = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return normal * np.outer(d, d)
