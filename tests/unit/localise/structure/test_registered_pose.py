import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from visloc_companion.errors import Reason
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.localise.registration.base import Registered
from visloc_companion.localise.structure.base import LocalCloud, NoCloud
from visloc_companion.localise.structure.cloud import _pixels
from visloc_companion.localise.structure.registered_pose import (
    BEND_SHARE,
    HEIGHT_SHARE,
    LEAST_TILT_M,
    NED_ENU,
    SIGMA_SCALE,
    TILT_SHARE,
    pose_from_registration,
)


@pytest.fixture
def cloud(structure):
    rng = np.random.default_rng(2)
    T = np.array([structure.pose(0, 0, 90), structure.pose(0, 27, 90, 2, -3, 10)])
    points = np.column_stack([rng.uniform(-60, 60, 3000), rng.uniform(-30, 60, 3000), rng.uniform(0, 15, 3000)])
    pix = _pixels(points, T[1], structure.WIDE)
    return LocalCloud(points, np.full(3000, 0.1), pix, (0, 1), T, 1, 0.01, 0.01, 0.01, ())


def similarity(yaw_deg, scale, shift, tilt_deg=0.0):
    T = np.eye(4)
    turn = cv2.Rodrigues(np.array([math.radians(tilt_deg), 0, 0]))[0] @ cv2.Rodrigues(np.array([0, 0, math.radians(yaw_deg)]))[0]
    T[:3, :3] = scale * turn
    T[:3, 3] = shift
    return T


def registered(T, sigma_up=0.3, sigma=0.4, deviation=1.2, bowl=0.0):
    evidence = (("deviation_m", deviation), ("bowl_m", bowl))
    return Registered(T, np.diag([sigma**2, sigma**2, sigma_up**2]), 0.005, 0.002, 0.01, evidence)


def test_the_camera_goes_where_the_similarity_takes_it(cloud, structure):
    T = similarity(4.0, 1.015, (5000.0, 3000.0, 400.0))
    prior = PriorTerm(NED_ENU @ similarity(4.0, 1, (0, 0, 0))[:3, :3] @ cloud.pose_of(1)[:3, :3], math.radians(0.5))
    found = pose_from_registration(cloud, registered(T), structure.WIDE, prior)
    east, north, up = T[:3, :3] @ cloud.pose_of(1)[:3, 3] + T[:3, 3]
    np.testing.assert_allclose(found.pose.p_ned_m, [north, east, -up], atol=0.02)
    np.testing.assert_allclose(found.pose.R_ned_cam, prior.R_ned_cam, atol=1e-3)


def test_the_covariance_is_the_registration_s_with_tilt_and_scale_carried_to_the_camera(cloud, structure):
    T = similarity(0.0, 1.0, (0.0, 0.0, 0.0))
    none = PriorTerm(NED_ENU @ cloud.pose_of(1)[:3, :3], math.inf)
    sigma = np.sqrt(np.diag(pose_from_registration(cloud, registered(T), structure.WIDE, none).covariance))
    reach = np.sqrt(((cloud.points_m[:, :2] - cloud.points_m[:, :2].mean(0)) ** 2).mean())
    lever = 83 * math.hypot(LEAST_TILT_M, TILT_SHARE * 1.2) / reach
    assert sigma[0] == pytest.approx(math.hypot(0.4, lever), rel=0.1)
    assert sigma[2] == pytest.approx(math.hypot(0.3, HEIGHT_SHARE * 1.2, 0.002 * 83, SIGMA_SCALE * 83), rel=0.05)
    tied = replace(none, sigma_tilt_rad=math.radians(0.05))
    better = np.sqrt(np.diag(pose_from_registration(cloud, registered(T), structure.WIDE, tied).covariance))
    assert better[0] < sigma[0]
    assert better[0] == pytest.approx(0.4, rel=0.2)


@pytest.mark.parametrize("bowl", [0.9, -0.9])
def test_a_cloud_that_is_bent_leans_and_the_camera_with_it(cloud, structure, bowl):
    T = similarity(0.0, 1.0, (0.0, 0.0, 0.0))
    none = PriorTerm(NED_ENU @ cloud.pose_of(1)[:3, :3], math.inf)
    level, bent = (
        pose_from_registration(cloud, registered(T, bowl=b), structure.WIDE, none).covariance[[0, 1, 2], [0, 1, 2]]
        for b in (0, bowl)
    )
    reach = np.sqrt(((cloud.points_m[:, :2] - cloud.points_m[:, :2].mean(0)) ** 2).mean())
    np.testing.assert_allclose(bent[:2] - level[:2], (83 * BEND_SHARE * bowl / reach) ** 2, rtol=0.2)
    assert bent[2] - level[2] < 0.1 * (bent[0] - level[0])


def test_a_good_attitude_takes_back_the_tilt_of_a_bad_registration(cloud, structure):
    """A cloud laid down tilted by 0.6° moves the camera by 0.9 m; an attitude good to 0.1° brings most of it back."""
    T = similarity(0.0, 1.0, (0.0, 0.0, 0.0), tilt_deg=0.6)
    true = cloud.pose_of(1)
    prior = PriorTerm(NED_ENU @ true[:3, :3], math.radians(0.1))
    free = replace(prior, sigma_tilt_rad=math.inf)
    middle_fixed = T.copy()
    middle = cloud.points_m.mean(0)
    middle_fixed[:3, 3] = middle - T[:3, :3] @ middle
    off = [
        np.linalg.norm(
            pose_from_registration(cloud, registered(middle_fixed), structure.WIDE, p).pose.p_ned_m - NED_ENU @ true[:3, 3]
        )
        for p in (free, prior)
    ]
    assert off[0] > 0.7
    assert off[1] < 0.35 * off[0]


def test_a_frame_that_shows_nothing_of_the_cloud_is_refused(cloud, structure):
    blind = replace(cloud, pix=np.full_like(cloud.pix, np.nan))
    found = pose_from_registration(blind, registered(np.eye(4)), structure.WIDE, PriorTerm(np.eye(3), 0.01))
    assert isinstance(found, NoCloud)
    assert found.reason is Reason.TOO_FEW_FEATURES


@pytest.mark.parametrize("of_heights", [0.0, 0.6, 1.0])
def test_a_height_that_gave_the_cloud_its_scale_already_is_not_counted_twice(cloud, structure, of_heights):
    """By the errors themselves: scale (2 % of it the baselines', the rest the height's), and the height that is stated again."""
    rng = np.random.default_rng(3)
    true, sigma_up, above = NED_ENU @ cloud.pose_of(1)[:3, 3], 2.0, 82.5  # of the camera above the cloud's middle
    per_height = of_heights / above
    sigma_scale = math.hypot(0.02, per_height * sigma_up)
    scaled = replace(cloud, sigma_scale=sigma_scale, scale_per_height=per_height)
    middle = np.array([*(cloud.points_m[:, :2].min(0) + cloud.points_m[:, :2].max(0)) / 2, cloud.points_m[:, 2].mean()])
    off, claimed = [], set()
    for _ in range(60):
        higher = rng.normal(0, sigma_up)
        T = np.eye(4)
        T[:3, :3] *= 1 + rng.normal(0, 0.02) + per_height * higher
        T[:3, 3] = middle - T[:3, :3] @ middle
        held = replace(registered(T, sigma_up=0.05, sigma=0.05, deviation=0.0), sigma_scale=sigma_scale)
        prior = PriorTerm(NED_ENU @ cloud.pose_of(1)[:3, :3], 0.001, 0.001, -true[2] + higher, sigma_up)
        found = pose_from_registration(scaled, held, structure.WIDE, prior)
        off.append(-found.pose.p_ned_m[2] + true[2])
        claimed.add(round(math.sqrt(found.covariance[2, 2]), 2))
    sigma = max(claimed)
    assert sigma - min(claimed) < 0.1
    assert 0.85 < np.sqrt(np.mean(np.square(off))) / sigma < 1.15
    assert sigma < min(sigma_up, math.hypot(sigma_scale, SIGMA_SCALE) * above) + 0.01  # two witnesses tell no less than one


def test_of_heights_the_cloud_s_scale_keeps_what_the_reliefs_leave_to_its_prior(cloud, structure):
    """Where the reliefs tell the scale, the height is news: its information adds up with theirs."""
    scaled = replace(cloud, sigma_scale=0.04, scale_per_height=0.01)
    none = PriorTerm(NED_ENU @ cloud.pose_of(1)[:3, :3], math.inf)
    told = replace(none, up_m=90.0, sigma_up_m=0.5)
    free, both = (pose_from_registration(scaled, registered(np.eye(4)), structure.WIDE, p).covariance[2, 2] for p in (none, told))
    assert both == pytest.approx(1 / (1 / free + 1 / 0.25), rel=0.03)
