import math

import numpy as np
import pytest

from visloc_companion.localise.structure.bundle import PosePriors, adjust, rotation_only_px
from visloc_companion.localise.structure.tracks import Tracks

FOCAL = 425.0


def tracks_of(truth, points, rng, noise_px=0.2, wrong=0):
    """Every point seen by every frame; the first `wrong` of them somewhere else by the last one."""
    frame, number, xy = [], [], []
    for k, T in enumerate(truth):
        q = (points - T[:3, 3]) @ T[:3, :3]
        seen = q[:, :2] / q[:, 2:3] + rng.normal(0, noise_px / FOCAL, (len(points), 2))
        if k == len(truth) - 1 and wrong:
            seen[:wrong] += rng.uniform(-0.2, 0.2, (wrong, 2))
        frame.append(np.full(len(points), k))
        number.append(np.arange(len(points)))
        xy.append(seen)
    return Tracks(np.concatenate(frame), np.concatenate(number), np.concatenate(xy), len(points), len(truth))


@pytest.fixture
def scene(structure):
    rng = np.random.default_rng(3)
    truth = np.array([structure.pose(0, 27.0 * k, 90, 1.0, 2.0, 5.0 * k) for k in range(3)])
    points = np.column_stack([rng.uniform(-50, 50, 300), rng.uniform(-10, 60, 300), rng.uniform(0, 20, 300)])
    prior = np.array([structure.disturbed(T, rng) for T in truth])
    sigma = np.tile([0.2, 0.2, 0.2, *[math.radians(0.5)] * 3], (3, 1))
    return rng, truth, points, PosePriors(prior, sigma)


def test_relative_poses_and_shape_are_found_in_spite_of_wrong_tracks(scene):
    rng, truth, points, priors = scene
    found = adjust(tracks_of(truth, points, rng, wrong=60), priors, FOCAL, 0.2)
    assert not found.good[:60].all()
    assert found.good[60:].mean() > 0.95
    relative = found.T_local_cam[0, :3, :3].T @ found.T_local_cam[2, :3, :3]
    right = truth[0, :3, :3].T @ truth[2, :3, :3]
    assert np.arccos((np.trace(relative @ right.T) - 1) / 2) < math.radians(0.1)
    # what is left of the points is a similarity: shift, turn and scale
    a, b = found.points[60:] - found.points[60:].mean(0), points[60:] - points[60:].mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    R, scale = vt.T @ u.T, s.sum() / (a**2).sum()
    assert np.sqrt((((scale * a @ R.T) - b) ** 2).mean()) < 0.1
    assert 0 < found.chi2 < 3


def test_covariance_is_that_of_the_errors(scene, structure):
    _, truth, points, priors = scene
    normalised = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        prior = np.array([structure.disturbed(T, rng) for T in truth])
        found = adjust(tracks_of(truth, points, rng), PosePriors(prior, priors.sigma), FOCAL, 0.2)
        baseline = (found.T_local_cam[2, :3, 3] - found.T_local_cam[0, :3, 3]) - (truth[2, :3, 3] - truth[0, :3, 3])
        J = np.zeros((3, 18))
        J[:, :3], J[:, 12:15] = -np.eye(3), np.eye(3)
        C = J @ found.covariance @ J.T
        normalised.append(baseline @ np.linalg.solve(C, baseline) / 3)
    assert 0.4 < np.mean(normalised) < 2.0


def test_a_mere_turn_leaves_no_parallax(scene, structure):
    rng, truth, points, _ = scene
    turned = truth.copy()
    turned[:, :3, 3] = truth[0, :3, 3]
    assert rotation_only_px(tracks_of(turned, points, rng), 2, FOCAL) < 0.6
    assert rotation_only_px(tracks_of(truth, points, rng), 1, FOCAL) > 5
