"""The reference frame's pose from the registered cloud: PnP of its pixels, and a covariance that knows what the points share.

Every point of a cloud moves with the cloud's similarity, so the scatter of their pixels says little about where the camera is:
the registration's own covariance is carried over to the camera, tilt and scale included, and then weighed with the attitude.

Where the heights of the frames gave the cloud part of its scale, the camera's height is off by part of their error already. So
the autopilot's height is weighed as a measurement whose error is correlated with the pose's: it tells only what it adds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import pinhole_matrix, unproject
from visloc_companion.localise.align import moved
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import LEAST_SIGMA, PoseEstimate, PriorTerm, solve_pose
from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.registration.clouds import middle_m
from visloc_companion.localise.structure.base import LocalCloud, NoCloud
from visloc_companion.types import CameraModel, FloatArray

MOST_POINTS = 400
FEWEST_POINTS = 12
SIGMA_PX = 0.5
HEIGHT_SHARE, TILT_SHARE = 0.8, 0.25
"""Of the deviation of the heights that the clouds differ by: what another season, felling and growth have of their error in
common, in height over the whole cloud and between its halves. Clouds of lasers differ by holes and noise, which share less."""
BEND_SHARE = 0.3
"""Of the bowl that was taken out: a cloud that is bent leans as well, and the camera with it. Of 51 fixes over changed land
(seeds 60 to 69 of benchmarks/changed_land.py) the third that was bent most erred by 1.2 sigma without it, the others by 0.8."""
SIGMA_SCALE, LEAST_TILT_M = 0.004, 0.05
"""Relative error of the scale that stereo clouds have in common, added to the registration's, and least error
of height between a cloud's halves. All four: seeds below 100 of benchmarks/structure_chain.py."""
NED_ENU: FloatArray = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def pose_from_registration(
    cloud: LocalCloud, registered: Registered, model: CameraModel, prior: PriorTerm
) -> PoseEstimate | NoCloud:
    """Pose (north, east, down of the reference's axes) and covariance of `cloud.reference`.

    `prior` is the autopilot's attitude (and height, where it has one: that which the cloud's `scale_per_height` is of) in the
    reference's axes: it is weighed with the tilt that the registration gives to the frame, whose sigma is that of the height
    between the cloud's halves divided by its half-width.
    """
    shown = np.flatnonzero(np.isfinite(cloud.pix).all(1))
    if len(shown) < FEWEST_POINTS:
        return NoCloud(Reason.TOO_FEW_FEATURES, f"the frame shows {len(shown)} points of the cloud")
    shown = shown[:: max(1, len(shown) // MOST_POINTS)]
    T = registered.T_reference_source
    ground = (cloud.points_m[shown] @ T[:3, :3].T + T[:3, 3]) @ NED_ENU.T
    K = pinhole_matrix(model)
    pix = unproject(model, cloud.pix[shown]) @ K.T
    free = PriorTerm(prior.R_ned_cam, math.inf)
    found = solve_pose(ground, pix[:, :2], np.full(len(shown), SIGMA_PX), K, _carried(cloud, T), free)
    if found is None:
        return NoCloud(Reason.POSE_FAILED, f"PnP of {len(shown)} points is undetermined")
    J = _of_similarity(cloud, registered, found.pose)
    covariance = found.covariance + J @ _errors(cloud, registered) @ J.T
    pose, covariance = _with_height(found.pose, covariance, prior, J[:, 6] * _scale_per_height(cloud, registered))
    information, pull = replace(prior, sigma_up_m=math.inf).at(pose)
    posterior = np.asarray(np.linalg.inv(np.linalg.inv(covariance) + information), dtype=np.float64)
    return replace(found, pose=moved(pose, posterior @ pull), covariance=posterior)


def _carried(cloud: LocalCloud, T: FloatArray) -> CameraPose:
    """The reference frame's pose in the cloud, carried to the reference: where the PnP starts."""
    camera = cloud.pose_of(cloud.reference)
    R = T[:3, :3] / np.cbrt(np.linalg.det(T[:3, :3]))
    return CameraPose(NED_ENU @ (T[:3, :3] @ camera[:3, 3] + T[:3, 3]), NED_ENU @ R @ camera[:3, :3])


def _scale_per_height(cloud: LocalCloud, registered: Registered) -> float:
    """What is left of the cloud's `scale_per_height` where the reliefs had their say in the scale: the prior's share of it."""
    return cloud.scale_per_height * min(1.0, (registered.sigma_scale / max(cloud.sigma_scale, LEAST_SIGMA)) ** 2)


def _with_height(
    pose: CameraPose, covariance: FloatArray, prior: PriorTerm, per_height: FloatArray
) -> tuple[CameraPose, FloatArray]:
    """Pose and covariance (6, 6) with the prior's height, for each metre of whose error the pose errs by `per_height` (6,) too:
    the best linear estimate where the errors of state and measurement are correlated."""
    if not math.isfinite(prior.sigma_up_m):
        return pose, covariance
    variance = max(prior.sigma_up_m, LEAST_SIGMA) ** 2
    both = per_height * variance
    apart = covariance[2, 2] + variance - 2 * both[2]
    gain = (covariance[:, 2] - both) / apart
    higher_m = prior.up_m + float(pose.p_ned_m[2])
    return moved(pose, gain * higher_m), covariance - apart * np.outer(gain, gain)


def _of_similarity(cloud: LocalCloud, registered: Registered, pose: CameraPose) -> FloatArray:
    """(6, 7) by how much the camera's north, east, up, rotation about n, e, d change with shifts of the cloud's middle to the
    north, east and down, turns about these and the logarithm of the scale."""
    T = registered.T_reference_source
    arm = pose.p_ned_m - NED_ENU @ (T[:3, :3] @ middle_m(cloud.points_m) + T[:3, 3])
    J = np.zeros((6, 7))
    J[:3, :3] = np.eye(3)
    J[:3, 3:6] = -np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
    J[:3, 6] = arm
    J[3:, 3:6] = np.eye(3)
    J[2] *= -1  # up
    return J


def _errors(cloud: LocalCloud, registered: Registered) -> FloatArray:
    """(7, 7) covariance of these about the cloud's middle."""
    reach = float(np.sqrt(((cloud.points_m[:, :2] - middle_m(cloud.points_m)[:2]) ** 2).mean()))
    evidence = dict(registered.evidence)
    deviation = evidence["deviation_m"]
    tilt = math.hypot(LEAST_TILT_M, TILT_SHARE * deviation, BEND_SHARE * evidence["bowl_m"]) / max(reach, 1e-3)
    error = np.zeros((7, 7))
    error[:3, :3] = NED_ENU @ registered.covariance_m2 @ NED_ENU.T
    error[2, 2] += (HEIGHT_SHARE * deviation) ** 2
    error[3:, 3:] = np.diag([tilt**2, tilt**2, registered.sigma_yaw_rad**2, registered.sigma_scale**2 + SIGMA_SCALE**2])
    return error
