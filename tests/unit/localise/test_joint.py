from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise import align
from visloc_companion.localise.candidates.descent import rectified
from visloc_companion.localise.candidates.pyramid import LEVELS, view, window
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.joint import (
    JointFrame,
    JointResult,
    RelativePose,
    frame_to_frame_term,
    joint_alignment,
    odometry_term,
)
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.plan import SearchPlan, make_plan
from visloc_companion.localise.settings import LocaliserSettings
from visloc_companion.types import CameraModel

MODEL = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
TRUE = [((-30.0, -60.0, -240.0), 0.6), ((-12.0, -35.0, -238.0), 0.65), ((10.0, -12.0, -241.0), 0.6)]


def camera_pose(p, yaw, tilt=(0.0, 0.0)) -> CameraPose:
    return CameraPose(np.array(p, dtype=float), R_from_quat(quat_from_euler(*tilt, yaw)) @ R_FRD_CAM)


def between(first: CameraPose, second: CameraPose, number: int = 0) -> RelativePose:
    R = first.R_ned_cam.T
    covariance = np.diag([0.2**2] * 3 + [0.005**2] * 3)
    return RelativePose(number, number + 1, R @ (second.p_ned_m - first.p_ned_m), R @ second.R_ned_cam, covariance)


@pytest.mark.parametrize("seed", range(3))
def test_odometry_alone_brings_two_poses_to_their_relation(seed):
    rng = np.random.default_rng(seed)
    first, second = camera_pose((0.0, 0.0, -200.0), 0.3, (0.2, -0.1)), camera_pose((40.0, 10.0, -205.0), 0.5, (-0.1, 0.1))
    relative = between(first, second)
    poses = [align.moved(p, np.append(rng.normal(0, 3, 3), rng.normal(0, 0.05, 3))) for p in (first, second)]
    for _ in range(6):
        H, b = odometry_term(relative, *poses)
        delta = np.linalg.solve(H + np.eye(12) * 1e-6, b).reshape(2, 6)
        poses = [align.moved(pose, d) for pose, d in zip(poses, delta, strict=True)]
    R = poses[0].R_ned_cam.T
    np.testing.assert_allclose(R @ (poses[1].p_ned_m - poses[0].p_ned_m), relative.p_first_m, atol=1e-3)
    np.testing.assert_allclose(R @ poses[1].R_ned_cam, relative.R_first_second, atol=1e-5)


def test_frame_to_frame_term_pulls_a_frame_onto_the_other(flat, support):
    """With the first frame held at its true pose, the term alone brings the second back from 3 m and a degree."""
    (p0, yaw0), (p1, yaw1) = TRUE[:2]
    true = [camera_pose(p0, yaw0), camera_pose(p1, yaw1)]
    request = support.request_at(p0, (0.0, 0.0, yaw0))
    plan = make_plan(request.prior, MODEL, flat, LocaliserSettings())
    assert isinstance(plan, SearchPlan)
    origin = np.array([p0[0], p0[1], 0.0])
    looks = [view(support.render(flat, MODEL, p, (0.0, 0.0, yaw)), MODEL, plan, request.prior, plan.frame) for p, yaw in TRUE[:2]]
    grid = window(looks[0], looks[0].start, LEVELS[0], flat, plan.frame, GRADIENT)
    frames = [look.on(grid, GRADIENT) for look in looks]
    fixed, goal = (CameraPose(pose.p_ned_m - origin, pose.R_ned_cam) for pose in true)
    pose = align.moved(goal, np.array([2.5, -1.5, 0.0, 0.0, 0.0, math.radians(1)]))
    held = rectified(frames[0], fixed, grid)
    stiff = np.diag([0.0, 0.0, 1.0, 1e6, 1e6, 0.0])
    for _ in range(8):
        H, b = frame_to_frame_term(grid, (fixed, held), (pose, rectified(frames[1], pose, grid)))
        pose = align.moved(pose, np.linalg.solve(H[6:, 6:] + stiff, b[6:]))
    assert np.hypot(*(pose.p_ned_m - goal.p_ned_m)[:2]) < 0.5
    assert abs(float(np.asarray(cv2.Rodrigues(pose.R_ned_cam @ goal.R_ned_cam.T)[0]).ravel()[2])) < 0.005


def flight(world, support, offset, yaw_off, sigma_m=12.0):
    """Frames at the true poses; priors carried on by true odometry from a first one that is off."""
    true = [camera_pose(p, yaw) for p, yaw in TRUE]
    odometry = [between(true[k], true[k + 1], k) for k in range(2)]
    start = camera_pose(np.array(TRUE[0][0]) + offset, TRUE[0][1] + yaw_off)
    believed = [start]
    for step in odometry:
        last = believed[-1]
        believed.append(CameraPose(last.p_ned_m + last.R_ned_cam @ step.p_first_m, last.R_ned_cam @ step.R_first_second))
    frames = [
        JointFrame(
            support.render(world, MODEL, p, (0.0, 0.0, yaw)),
            support.request_at(
                tuple(pose.p_ned_m), (0.0, 0.0, yaw + yaw_off), sigma_m=sigma_m, sigma_h_m=10.0, sigma_yaw_deg=8.0
            ).prior,
        )
        for (p, yaw), pose in zip(TRUE, believed, strict=True)
    ]
    return frames, odometry


def errors_m(result: JointResult, first_prior) -> list[float]:
    origin = np.array([first_prior[0], first_prior[1]])
    return [
        float(np.hypot(*(p.pose.p_ned_m[:2] + origin - np.array(t[:2])))) for p, (t, _) in zip(result.poses, TRUE, strict=True)
    ]


@pytest.mark.parametrize("world", ["flat", "hilly"])
def test_frames_of_a_flight_are_found_together(world, support, request):
    ref = request.getfixturevalue(world)
    offset = np.array([9.0, -8.0, 6.0])
    frames, odometry = flight(ref, support, offset, 0.12)
    result = joint_alignment(frames, odometry, MODEL, ref, GRADIENT)
    assert isinstance(result, JointResult)
    assert max(errors_m(result, np.array(TRUE[0][0]) + offset)) < 0.6
    for pose in result.poses:
        assert pose.score > 0.6
        assert np.linalg.eigvalsh(pose.covariance).min() > 0
        assert pose.covariance[0, 0] < 4.0


def test_a_frame_that_the_map_does_not_show_is_carried_by_its_neighbours(flat, support):
    offset = np.array([3.0, -3.0, 0.0])
    frames, odometry = flight(flat, support, offset, 0.02)
    coarse = np.random.default_rng(1).integers(0, 255, (30, 40)).astype(np.uint8)
    blind = cv2.resize(coarse, (160, 120), interpolation=cv2.INTER_CUBIC)
    result = joint_alignment([*frames[:2], JointFrame(blind, frames[2].prior)], odometry, MODEL, flat, GRADIENT)
    assert isinstance(result, JointResult)
    found = errors_m(result, np.array(TRUE[0][0]) + offset)
    assert max(found[:2]) < 0.8
    assert found[2] < 1.5
    assert result.poses[2].score < 0.3


def test_frame_that_cannot_take_part_is_named(flat, support):
    frames, odometry = flight(flat, support, np.zeros(3), 0.0)
    dark = JointFrame(np.zeros((120, 160), np.uint8), frames[1].prior)
    answer = joint_alignment([frames[0], dark, frames[2]], odometry, MODEL, flat, GRADIENT)
    assert not isinstance(answer, JointResult)
    assert answer[0] is Reason.TOO_DARK
    assert "frame 1" in answer[1]
