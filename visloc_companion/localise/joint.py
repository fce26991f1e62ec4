"""Several overlapping frames aligned together, with visual odometry between them.

After Sabel, Maki, Westin & Åsvärn 2022: one cost over all poses, minimised by Gauss-Newton through the levels of pyramid.py, of

* frame to map: the features of each frame against the map's (align.py), with the prior of its attitude and height;
* odometry: the relative pose of two frames with its covariance;
* frame to frame: the features of both on the ground that they share. With F_i(x) = S(x + D_i d_i) for a scene S, to first order
  F_i - F_j = grad S (D_i d_i - D_j d_j); grad S is that of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.localise import align
from visloc_companion.localise.candidates.descent import CORRELATED_PX, MAX_STEP_PX, MIN_PIXELS, Rectified, rectified
from visloc_companion.localise.candidates.frame_features import FrameFeatures
from visloc_companion.localise.candidates.pyramid import LEVELS, LowPassed, View, blurred, view, window
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.local_frame import LocalFrame, local_frame
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.plan import SearchPlan, planned
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import CameraModel, FloatArray, Image, PosePrior

_UP_FROM_DOWN = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class JointFrame:
    """A frame and the prior of its pose."""

    pixels: Image
    prior: PosePrior


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """What odometry says of two frames, by their numbers: position (3,) of the second camera in the first's axes, metres,
    `R_first_second` (3, 3), and the covariance (6, 6) of position and rotation vector, both in the first camera's axes."""

    first: int
    second: int
    p_first_m: FloatArray
    R_first_second: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class JointPose:
    """Pose, covariance (6, 6) of (north, east, up, rotation about n, e, d) and correlation with the map at the end."""

    pose: CameraPose
    covariance: FloatArray
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class JointResult:
    """Poses in metres about `local`, in the order of the frames."""

    local: LocalFrame
    poses: list[JointPose]


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """A frame at one pass: its features, the map's window and the window's side of the alignment, about where the pass starts."""

    view: View
    features: FrameFeatures
    grid: MapGrid
    sums: align.MapSums


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations (6N, 6N), (6N,) of all poses at the present ones, and each frame's correlation with the map (N,)."""

    H: FloatArray
    b: FloatArray
    scores: FloatArray


def joint_alignment(
    frames: Sequence[JointFrame],
    odometry: Sequence[RelativePose],
    model: CameraModel,
    ref: ReferenceMap,
    features: Features,
    settings: LocaliserSettings | None = None,
) -> JointResult | tuple[Reason, str]:
    """The poses of all frames, or why one of them cannot take part. Raises OutsideMap.

    The priors' headings and heights are taken as one measurement made once (frames of one flight share compass and barometer),
    their tilts as one a frame.
    """
    local = local_frame(frames[0].prior.place, ref)
    views = []
    for number, frame in enumerate(frames):
        plan = planned(frame.prior, frame.pixels, model, ref, settings or LocaliserSettings())
        if not isinstance(plan, SearchPlan):
            return plan[0], f"frame {number}: {plan[1]}"
        views.append(_shared_prior(view(frame.pixels, model, plan, frame.prior, local), len(frames)))
    poses = [v.start for v in views]
    equations = None
    for level in LEVELS:
        grids = [window(v, pose, level, ref, local, features) for v, pose in zip(views, poses, strict=True)]
        looks = [v.on(grid, features) for v, grid in zip(views, grids, strict=True)]
        for sigma_px, steps in level.passes:
            smooth = [blurred(grid, sigma_px) for grid in grids]
            sights = [
                _Sight(v, LowPassed(look, sigma_px), grid, align.map_sums(align.prepare(grid), grid, pose))
                for v, look, grid, pose in zip(views, looks, smooth, poses, strict=True)
            ]
            poses, equations = _descended(sights, poses, odometry, steps)
    if equations is None:
        return Reason.LOW_OVERLAP, "no frame overlaps with the map"
    return JointResult(local, _results(poses, equations))


def _shared_prior(one: View, n: int) -> View:
    wider = math.sqrt(n)
    prior = replace(one.prior, sigma_yaw_rad=one.prior.sigma_yaw_rad * wider, sigma_up_m=one.prior.sigma_up_m * wider)
    return replace(one, prior=prior)


def _descended(
    sights: list[_Sight], poses: list[CameraPose], odometry: Sequence[RelativePose], steps: int
) -> tuple[list[CameraPose], _Equations]:
    """Gauss-Newton over all poses, at most `steps` of them; the poses with the best correlation with the map on the way."""
    gsd_m = sights[0].grid.gsd_m
    best_poses, best = poses, _equations(sights, poses, odometry)
    now = best
    for _ in range(steps):
        damped = now.H + np.diag(np.diag(now.H)) * 1e-6 + np.eye(len(now.b)) * 1e-9
        delta = np.asarray(np.linalg.solve(damped, now.b), dtype=np.float64).reshape(-1, 6)
        moved_px = float(np.abs(delta[:, :3]).max()) / gsd_m
        if not math.isfinite(moved_px):
            break
        delta *= min(1.0, MAX_STEP_PX / max(moved_px, 1e-9))
        poses = [align.moved(pose, d) for pose, d in zip(poses, delta, strict=True)]
        now = _equations(sights, poses, odometry)
        if now.scores.mean() > best.scores.mean():
            best_poses, best = poses, now
    return best_poses, best


def _equations(sights: list[_Sight], poses: list[CameraPose], odometry: Sequence[RelativePose]) -> _Equations:
    n = len(sights)
    H, b, scores = np.zeros((6 * n, 6 * n)), np.zeros(6 * n), np.zeros(n)
    seen = [rectified(sight.features, pose, sight.grid) for sight, pose in zip(sights, poses, strict=True)]
    for k, (sight, pose) in enumerate(zip(sights, poses, strict=True)):
        at = slice(6 * k, 6 * k + 6)
        information, pull = sight.view.prior.at(pose)
        H[at, at] += information
        b[at] += pull
        if seen[k].weight.sum() < MIN_PIXELS:
            continue
        step = align.gauss_newton_step(sight.sums, seen[k].smooth, seen[k].weight, information, pull, CORRELATED_PX)
        H[at, at] += step.information
        b[at] += (step.information + information) @ step.delta - pull
        scores[k] = step.score
    for relative in odometry:
        i, j = relative.first, relative.second
        both = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        other = rectified(sights[j].features, poses[j], sights[i].grid)
        for information, rhs in (
            odometry_term(relative, poses[i], poses[j]),
            frame_to_frame_term(sights[i].grid, (poses[i], seen[i]), (poses[j], other)),
        ):
            H[np.ix_(both, both)] += information
            b[both] += rhs
    return _Equations(H, b, scores)


def odometry_term(relative: RelativePose, first: CameraPose, second: CameraPose) -> tuple[FloatArray, FloatArray]:
    """Information (12, 12) and right side (12,) of odometry at two poses, for corrections as of `align.moved`."""
    R = first.R_ned_cam.T
    apart = second.p_ned_m - first.p_ned_m
    J = np.zeros((6, 12))
    J[:3, :3], J[:3, 6:9] = -R @ _UP_FROM_DOWN, R @ _UP_FROM_DOWN
    J[:3, 3:6] = R @ _cross(apart)
    J[3:, 3:6], J[3:, 9:12] = -R, R
    turned = cv2.Rodrigues(R @ second.R_ned_cam @ relative.R_first_second.T)[0].ravel()
    residual = np.concatenate([relative.p_first_m - R @ apart, -np.asarray(turned, dtype=np.float64)])
    weighted = J.T @ np.linalg.inv(relative.covariance)
    return weighted @ J, weighted @ residual


def frame_to_frame_term(
    grid: MapGrid, first: tuple[CameraPose, Rectified], second: tuple[CameraPose, Rectified]
) -> tuple[FloatArray, FloatArray]:
    """Information (12, 12) and right side (12,) of two frames rectified over the same window; zero where they do not overlap."""
    stride = 2 if grid.weight.size > align.DENSE_PIXELS else 1
    weight = (first[1].weight * second[1].weight)[::stride, ::stride]
    picked = weight > 0
    H, b = np.zeros((12, 12)), np.zeros(12)
    w = weight[picked]
    if w.sum() * stride**2 < MIN_PIXELS:
        return H, b
    mean = align.prepare(replace(grid, features=(first[1].features + second[1].features) * np.float32(0.5)))
    D = [np.stack(align.displacements(grid, pose, stride))[:, :, picked] for pose, _ in (first, second)]
    A_ne = np.concatenate([D[0], -D[1]], axis=1)
    difference = (first[1].smooth - second[1].smooth)[::stride, ::stride][picked]
    d_north, d_east = mean.d_north[::stride, ::stride][picked], mean.d_east[::stride, ::stride][picked]
    for c in range(difference.shape[1]):
        G = A_ne[0] * d_north[:, c] + A_ne[1] * d_east[:, c]
        Gw = G * w
        H += Gw @ G.T
        b += Gw @ difference[:, c]
    variance = float(np.sum(w[:, None] * difference**2)) / (float(w.sum()) * difference.shape[1])
    noise = max(variance, 1e-6) * CORRELATED_PX / stride**2
    return H / noise, b / noise


def _results(poses: list[CameraPose], equations: _Equations) -> list[JointPose]:
    covariance = np.asarray(np.linalg.inv(equations.H + np.eye(len(equations.b)) * 1e-9), dtype=np.float64)
    return [
        JointPose(pose, covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], float(equations.scores[k]))
        for k, pose in enumerate(poses)
    ]


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
