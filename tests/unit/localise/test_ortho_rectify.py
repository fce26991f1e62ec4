from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.frame import full_level, reduced
from visloc_companion.localise.local_frame import local_frame
from visloc_companion.localise.mapped.window import cropped, map_grid
from visloc_companion.localise.ortho_rectify import CameraPose, rectify_plane, rectify_surface, sampling_weight
from visloc_companion.localise.template import GREY
from visloc_companion.types import CameraModel, GeoPoint

HOME = GeoPoint(47.0, 8.0, 0.0)
MODEL = CameraModel(320, 240, 280.0, 280.0, 159.5, 119.5)


@pytest.mark.parametrize("world", ["flat", "hilly"])
@pytest.mark.parametrize("tilt_deg", [0, 20, 45])
def test_rectified_frame_lies_on_the_map(world, tilt_deg, support, request):
    ref = request.getfixturevalue(world)
    euler = (0.1, math.radians(tilt_deg), 0.8)
    truth = (10.0, -20.0, -220.0)
    frame = support.render(ref, MODEL, truth, euler)
    grid = map_grid(ref, local_frame(HOME, ref), np.array([-150.0, -170]), np.array([170.0, 130]), 1.0, GREY)
    pose = CameraPose(np.array(truth), R_from_quat(quat_from_euler(*euler)) @ R_FRD_CAM)
    image, seen = rectify_surface(full_level(frame, MODEL), pose, grid)
    both = seen & (grid.weight > 0)
    assert both.mean() > 0.1
    assert np.corrcoef(image[both], grid.features[..., 0][both])[0, 1] > 0.93
    moved = CameraPose(pose.p_ned_m + np.array([4.0, 0, 0]), pose.R_ned_cam)
    image, seen = rectify_surface(full_level(frame, MODEL), moved, grid)
    both = seen & (grid.weight > 0)
    assert np.corrcoef(image[both], grid.features[..., 0][both])[0, 1] < 0.85


def test_what_a_wall_hides_is_masked(flat, support):
    surface = flat.surface.copy()
    surface[200:300, 270:280] = 140.0
    walled = support.FlatMap(flat.pixels, surface)
    frame = np.full((240, 320), 100, np.uint8)
    grid = map_grid(walled, local_frame(HOME, walled), np.array([-60.0, -60]), np.array([60.0, 60]), 1.0, GREY)
    pose = CameraPose(np.array([0.0, 0.0, -220.0]), R_FRD_CAM)
    _, seen = rectify_surface(full_level(frame, MODEL), pose, grid)
    # the wall is 20.5 to 29.5 m east, 40 m high; from 120 m above the ground it hides the ground to 29.5 * 120 / 80 = 44 m
    middle = seen[60]
    assert not middle[60 + 33 : 60 + 40].any()
    assert middle[60 + 48 :].all()
    assert middle[: 60 + 18].all()


def test_horizon_and_ground_behind_the_camera_are_masked():
    level = full_level(np.full((240, 320), 100, np.uint8), MODEL)
    pose = CameraPose(np.array([0.0, 0.0, -100.0]), R_from_quat(quat_from_euler(0.0, 1.2, 0.0)) @ R_FRD_CAM)
    _, seen = rectify_plane(level, pose, np.array([[0.0, -10.0, 1000.0], [10.0, 0.0, -1000.0]]), (201, 201), 0.0)
    north = 1000.0 - 10.0 * np.flatnonzero(seen.any(1))
    assert north.min() > 0
    assert north.max() <= 300.0


def test_reduction_keeps_the_rays_and_does_not_alias():
    _, u = np.mgrid[0:240, 0:320]
    waves = (128 + 100 * np.sin(u * 2.6)).astype(np.uint8)
    level = reduced(full_level(waves, MODEL), 4.3)
    assert level.grey.std() < 0.25 * waves[::4, ::4].std()
    ramp = reduced(full_level((u / 2).astype(np.uint8), MODEL), 4.0)
    uv = np.array([[20.0, 30.0], [60.0, 10.0]])
    rays = (uv - ramp.K[:2, 2]) / np.array([ramp.K[0, 0], ramp.K[1, 1]])
    full_u = rays[:, 0] * 280 + 159.5
    np.testing.assert_allclose(ramp.grey[[30, 10], [20, 60]], full_u / 2, atol=0.5)
    same = full_level(waves, MODEL)
    assert reduced(same, 1.1) is same


def test_cropping_keeps_places(flat):
    grid = map_grid(flat, local_frame(HOME, flat), np.array([200.0, 200]), np.array([400.0, 400]), 2.0, GREY)
    small = cropped(grid)
    assert small.weight.shape < grid.weight.shape
    rows, cols = np.flatnonzero(grid.weight.any(1)), np.flatnonzero(grid.weight.any(0))
    a = grid.A_ne_pix @ np.array([cols[0], rows[0], 1.0])
    np.testing.assert_allclose(small.A_ne_pix @ np.array([0.0, 0.0, 1.0]), a)
    np.testing.assert_array_equal(small.features[0, 0], grid.features[rows[0], cols[0]])


def test_thinly_sampled_ground_counts_by_the_frame_pixels_that_it_holds():
    K = np.array([[200.0, 0, 160], [0, 200.0, 120], [0, 0, 1]])
    A = np.array([[0.0, -1.0, 300.0], [1.0, 0.0, 0.0]])
    pose = CameraPose(np.array([0.0, 0, -100]), R_from_quat(quat_from_euler(0, math.radians(45), 0)) @ R_FRD_CAM)
    weight = sampling_weight(K, pose, A, (1, 301), 0.0)
    assert weight is not None
    assert weight[290, 0] == 1.0
    axis = np.array([math.sin(math.radians(45)), 0, math.cos(math.radians(45))])
    for row in (0, 60):
        P = np.array([[300.0 - row, 0, 0], [301.0 - row, 0, 0], [300.0 - row, 1.0, 0]]) - pose.p_ned_m
        q = P @ pose.R_ned_cam
        uv = q[:, :2] / q[:, 2:] * 200
        pixels = abs(np.linalg.det(uv[1:] - uv[0]))
        assert P[0] @ axis == pytest.approx(q[0, 2])
        assert weight[row, 0] == pytest.approx(1.5 * pixels, rel=0.03)
    down = CameraPose(pose.p_ned_m, R_from_quat((1.0, 0.0, 0.0, 0.0)) @ R_FRD_CAM)
    assert sampling_weight(K, down, A, (1, 301), 0.0) is None


def test_what_the_lens_shows_twice_is_not_seen_beyond_its_reach():
    lens = CameraModel(320, 240, 130.0, 130.0, 159.5, 119.5, (-0.3, 0.0, 0.0, 0.0, 0.0))
    level = full_level(np.full((240, 320), 100, np.uint8), lens)
    v, u = np.mgrid[0:240, 0:320]
    tan = np.hypot(u - 159.5, v - 119.5) / 130.0
    assert (level.valid[tan > 1.06] == 0).all()
    assert (level.valid[tan < 1.0] == 255).all()
