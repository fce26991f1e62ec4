from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.align import displacements, moved
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid
from visloc_companion.localise.pose import (
    PoseEstimate,
    PriorTerm,
    freed_of_slope,
    heading_and_tilt,
    heading_from,
    solve_pose,
    turned_about_view,
    widened,
)

K = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])


def pose_of(p, roll, pitch, yaw) -> CameraPose:
    return CameraPose(np.array(p, dtype=float), R_from_quat(quat_from_euler(roll, pitch, yaw)) @ R_FRD_CAM)


def project(points, pose):
    q = (points - pose.p_ned_m) @ pose.R_ned_cam
    return q[:, :2] / q[:, 2:] * 400 + np.array([320, 240])


def ground(n, seed, relief_m):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-80, 80, (n, 2)), -rng.uniform(0, relief_m, n)])


@pytest.mark.parametrize("relief_m", [0.0, 20.0])
def test_exact_points_give_the_exact_pose(relief_m):
    truth = pose_of((10, -5, -150), 0.05, -0.1, 1.0)
    points = ground(30, 1, relief_m)
    start = pose_of((0, 0, -140), 0.04, -0.09, 0.95)
    estimate = solve_pose(points, project(points, truth), np.ones(30), K, start, PriorTerm(start.R_ned_cam, math.radians(5)), 30)
    assert estimate is not None
    np.testing.assert_allclose(estimate.pose.p_ned_m, truth.p_ned_m, atol=0.02)


def test_outliers_hardly_move_the_pose():
    truth = pose_of((0, 0, -150), 0, 0, 0)
    points = ground(40, 2, 0)
    pix = project(points, truth) + np.random.default_rng(1).normal(0, 0.3, (40, 2))
    pix[:10] += 15
    estimate = solve_pose(points, pix, np.full(40, 0.3), K, truth, PriorTerm(truth.R_ned_cam, math.radians(0.05)), 20)
    assert estimate is not None
    assert np.hypot(*estimate.pose.p_ned_m[:2]) < 0.2
    assert estimate.weights[:10].max() < 0.1


def test_claimed_covariance_is_what_repetition_shows():
    truth = pose_of((0, 0, -150), 0.02, 0.1, 0.4)
    rng = np.random.default_rng(5)
    errors, claimed = [], []
    for seed in range(150):
        points = ground(25, seed, 10)
        turn = rng.normal(0, math.radians(0.3), 2)
        prior = moved(truth, np.array([0, 0, 0, *turn, 0.0]))
        pix = project(points, truth) + rng.normal(0, 0.8, (25, 2))
        estimate = solve_pose(points, pix, np.full(25, 0.8), K, prior, PriorTerm(prior.R_ned_cam, math.radians(0.3)))
        assert estimate is not None
        errors.append((estimate.pose.p_ned_m - truth.p_ned_m) * [1, 1, -1])
        claimed.append(np.sqrt(np.diag(estimate.covariance)[:3]))
    ratio = np.sqrt(np.mean((np.array(errors) / np.array(claimed)) ** 2, axis=0))
    assert (ratio > 0.75).all()
    assert (ratio < 1.35).all()


@pytest.mark.parametrize("height_is_known", [False, True])
def test_what_a_longer_lens_moves_the_pose_by_is_told(height_is_known):
    truth, points = pose_of((10, -5, -150), 0.1, -0.25, 1.0), ground(60, 3, 10)
    up = {"up_m": 150.0, "sigma_up_m": 1.0} if height_is_known else {}
    prior, open_m2 = PriorTerm(truth.R_ned_cam, math.radians(0.5), **up), np.eye(60) * 0.5
    longer = (project(points, truth) - [320, 240]) * 1.02 + [320, 240]
    found = solve_pose(points, longer, np.ones(60), K, truth, prior, 20, heights_m2=open_m2)
    right = solve_pose(points, project(points, truth), np.ones(60), K, truth, prior, 20, heights_m2=open_m2)
    assert found is not None
    assert right is not None
    off_m = (found.pose.p_ned_m - truth.p_ned_m) * [1, 1, -1]
    assert np.hypot(*off_m[:2]) > 0.5, "a lens that nobody knows of moves a leaning camera"
    assert np.linalg.norm(off_m - 0.02 * found.per_focal[:3]) < 0.1 * np.linalg.norm(off_m)
    np.testing.assert_allclose(right.per_focal[:3], found.per_focal[:3], rtol=0.1, atol=5.0)


def test_points_that_count_for_a_quarter_leave_the_pose_twice_as_uncertain():
    truth = pose_of((0, 0, -150), 0.1, 0, 0)
    points = ground(40, 2, 10)
    pix = project(points, truth) + np.random.default_rng(1).normal(0, 0.3, (40, 2))
    free = PriorTerm(truth.R_ned_cam, math.radians(60))
    whole, quarter = (solve_pose(points, pix, np.full(40, 0.3), K, truth, free, 20, worth=np.full(40, w)) for w in (1.0, 0.25))
    assert whole is not None
    assert quarter is not None
    np.testing.assert_allclose(quarter.pose.p_ned_m, whole.pose.p_ned_m, atol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(quarter.covariance) / np.diag(whole.covariance)), 2.0, rtol=0.01)


def test_blocks_that_tell_nothing_leave_what_the_prior_claims():
    truth = pose_of((0, 0, -150), 0.1, 0, 0)
    points = ground(40, 2, 10)
    prior = PriorTerm(truth.R_ned_cam, math.radians(1.0), math.radians(2.0), 150.0, 1.6)
    told = {"worth": np.full(40, 1e-9), "widening": lambda _: 0.5}
    estimate = solve_pose(points, project(points, truth), np.full(40, 0.3), K, truth, prior, 20, **told)
    assert estimate is not None
    assert math.sqrt(estimate.covariance[2, 2]) == pytest.approx(1.6, rel=1e-3)
    assert math.sqrt(estimate.covariance[3, 3]) == pytest.approx(math.radians(1.0), rel=1e-3)


def test_what_widens_the_points_sigmas_is_asked_at_their_scatter():
    truth = pose_of((0, 0, -150), 0.1, 0, 0)
    points = ground(60, 2, 10)
    pix = project(points, truth) + np.random.default_rng(1).normal(0, 0.9, (60, 2))
    free = PriorTerm(truth.R_ned_cam, math.radians(60))
    asked: list[float] = []

    def twice(scatter: float) -> float:
        asked.append(scatter)
        return 2.0

    formal, widened_ = (solve_pose(points, pix, np.full(60, 0.3), K, truth, free, 20, widening=w) for w in (None, twice))
    np.testing.assert_allclose(np.sqrt(np.diag(widened_.covariance) / np.diag(formal.covariance)), 2.0, rtol=0.02)
    assert asked[-1] == pytest.approx(3.0, rel=0.3)


def test_a_narrow_kernel_is_moved_less_by_points_that_are_wrong():
    truth = pose_of((0, 0, -150), 0, 0, 0)
    points = ground(40, 2, 0)
    pix = project(points, truth) + np.random.default_rng(1).normal(0, 0.3, (40, 2))
    pix[:14] += 1.5
    prior = PriorTerm(truth.R_ned_cam, math.radians(0.05))
    off = [solve_pose(points, pix, np.full(40, 0.3), K, truth, prior, 20, cauchy=c).pose.p_ned_m[:2] for c in (2.0, 1.0)]
    assert np.hypot(*off[1]) < 0.7 * np.hypot(*off[0])


def test_claims_hold_over_ground_of_unknown_slope():
    """A lean of the ground looks like a tilt: prior and picture share it, and the position's claim holds what that moves."""
    truth = pose_of((0, 0, -150), 0.06, -0.1, 0.4)
    sigma_tilt, sigma_slope = math.radians(6), math.radians(2.5)
    rng = np.random.default_rng(7)
    errors, claimed, formal = [], [], []
    for seed in range(120):
        points = ground(36, seed, 0)
        arm = points[:, :2] - points[:, :2].mean(0)
        real = points - np.outer(arm @ rng.normal(0, sigma_slope, 2), (0, 0, 1))
        prior = moved(truth, np.array([0, 0, 0, *rng.normal(0, sigma_tilt, 2), 0.0]))
        pix = project(real, truth) + rng.normal(0, 0.8, (36, 2))
        term = PriorTerm(prior.R_ned_cam, sigma_tilt)
        known = solve_pose(points, pix, np.full(36, 0.8), K, prior, term, 15)
        apparent = solve_pose(points, pix, np.full(36, 0.8), K, prior, widened(term, sigma_slope), 15)
        assert known is not None
        assert apparent is not None
        open_ = freed_of_slope(apparent, term, sigma_slope, 0.0)
        errors.append(open_.pose.p_ned_m[:2] - truth.p_ned_m[:2])
        claimed.append(np.sqrt(np.diag(open_.covariance)[:2]))
        formal.append(np.sqrt(np.diag(known.covariance)[:2]))
    ratio = np.sqrt(np.mean((np.array(errors) / np.array(claimed)) ** 2, axis=0))
    assert (ratio > 0.75).all()
    assert (ratio < 1.3).all()
    assert np.median(claimed) > 3 * np.median(formal)


def test_a_well_known_tilt_is_not_given_up_for_the_slope():
    truth = pose_of((0, 0, -150), 0, 0, 0)
    points = ground(30, 3, 0)
    leaning = points - np.outer(points[:, :2] @ np.array([math.radians(4), 0]), (0, 0, 1))
    term = PriorTerm(truth.R_ned_cam, math.radians(0.2))
    sigma_slope = math.radians(3)
    apparent = solve_pose(points, project(leaning, truth), np.full(30, 0.5), K, truth, widened(term, sigma_slope), 15)
    assert apparent is not None
    estimate = freed_of_slope(apparent, term, sigma_slope, 0.0)
    assert np.hypot(*apparent.pose.p_ned_m[:2]) > 5
    assert np.hypot(*estimate.pose.p_ned_m[:2]) < 0.5


def test_a_known_slope_leaves_the_pose_as_it_was():
    truth = pose_of((0, 0, -150), 0, 0.1, 0)
    points = ground(30, 3, 0)
    term = PriorTerm(truth.R_ned_cam, math.radians(2))
    apparent = solve_pose(points, project(points, truth), np.full(30, 0.5), K, truth, term)
    assert apparent is not None
    assert freed_of_slope(apparent, term, 0.0, 0.0) is apparent


def test_what_a_picture_without_a_tilt_leaves_open_is_the_prior():
    """Where only the prior knows the tilt, its sigma is claimed, neither less nor that of prior and slope together."""
    pose = pose_of((0, 0, -150), 0.0, 0.0, 0.3)
    term, sigma_slope = PriorTerm(pose.R_ned_cam, math.radians(4)), math.radians(3)
    turn = (turned_about_view(pose, 0.0, np.array([1e-6, 0, 0])).p_ned_m - pose.p_ned_m) / 1e-6
    np.testing.assert_allclose(turn, [0, 150, 0], atol=1e-3)
    covariance = np.diag([1e-4, 1e-4, 1e-4, *[widened(term, sigma_slope).sigma_tilt_rad ** 2] * 2, 1e-6])
    apparent = PoseEstimate(pose, covariance, 1.0, np.ones(4), np.zeros(6), term.sigma_tilt_rad, 0.0)
    freed = freed_of_slope(apparent, term, sigma_slope, 0.0)
    assert np.sqrt(np.diag(freed.covariance)[3:5]) == pytest.approx(math.radians(4))


def test_too_few_points_and_points_behind_the_camera_give_none():
    truth = pose_of((0, 0, -150), 0, 0, 0)
    prior = PriorTerm(truth.R_ned_cam, 0.01)
    assert solve_pose(np.zeros((2, 3)), np.zeros((2, 2)), np.ones(2), K, truth, prior) is None
    above = np.column_stack([ground(5, 1, 0)[:, :2], np.full(5, -300.0)])
    assert solve_pose(above, np.zeros((5, 2)), np.ones(5), K, truth, prior) is None


def test_the_heading_alone_is_that_of_both():
    rng = np.random.default_rng(2)
    for _ in range(50):
        a, b = (pose_of((0, 0, 0), *rng.uniform(-3, 3, 3)).R_ned_cam for _ in range(2))
        assert heading_from(a, b) == heading_and_tilt(a, b)[0]


def test_heading_and_tilt_come_apart():
    prior = pose_of((0, 0, -1), 0.1, 0.3, 1.0)
    turned = pose_of((0, 0, -1), 0.1, 0.3, 1.7)
    heading, tilt = heading_and_tilt(turned.R_ned_cam, prior.R_ned_cam)
    assert heading == pytest.approx(0.7)
    np.testing.assert_allclose(tilt, 0, atol=1e-9)
    tilted = moved(prior, np.array([0, 0, 0, 0.02, -0.01, 0.0]))
    heading, tilt = heading_and_tilt(tilted.R_ned_cam, prior.R_ned_cam)
    np.testing.assert_allclose(tilt, [0.02, -0.01], atol=1e-4)
    information, pull = PriorTerm(prior.R_ned_cam, 0.1).at(tilted)
    np.testing.assert_allclose(np.diag(information), [0, 0, 0, 100, 100, 0])
    np.testing.assert_allclose(pull[3:5], [-2.0, 1.0], atol=1e-2)


def test_displacements_are_the_derivative_of_where_rays_meet_the_ground():
    pose = pose_of((3, 4, -120), 0.1, -0.2, 0.7)
    grid = MapGrid(
        np.zeros((5, 7, 2), np.float32),
        np.ones((5, 7), np.float32),
        np.full((5, 7), 20.0, np.float32),
        np.array([[0.0, -6.0, 20.0], [6.0, 0.0, -15.0]]),
        6.0,
    )
    north, east = displacements(grid, pose)
    v, u = np.mgrid[0:5, 0:7]
    points = np.stack([-6.0 * v + 20, 6.0 * u - 15, np.full(v.shape, -20.0)], -1)
    rays = (points - pose.p_ned_m) @ pose.R_ned_cam
    for k in range(6):
        delta = np.zeros(6)
        delta[k] = 1e-5
        after = moved(pose, delta)
        w = rays @ after.R_ned_cam.T
        hit = after.p_ned_m + w * ((-20.0 - after.p_ned_m[2]) / w[..., 2])[..., None]
        np.testing.assert_allclose((hit - points)[..., 0] / 1e-5, north[k], atol=2e-2 * max(1.0, np.abs(north[k]).max()))
        np.testing.assert_allclose((hit - points)[..., 1] / 1e-5, east[k], atol=2e-2 * max(1.0, np.abs(east[k]).max()))
