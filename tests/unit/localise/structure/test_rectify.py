import math

import numpy as np
import pytest

from visloc_companion.localise.structure.disparity import Disparity
from visloc_companion.localise.structure.rectify import rectify, seen_in_right
from visloc_companion.localise.structure.surface import triangulated


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ((0, 0, 90), (0, 27, 90)),
        ((0, 0, 90), (-20, 15, 93, 0, 0, 140)),
        ((0, 0, 90, 18, -6, 30), (20, 10, 88, 12, 8, 35)),
    ],
)
def test_a_point_lies_on_one_row_and_its_disparity_is_its_depth(structure, left, right):
    T = [structure.pose(*left), structure.pose(*right)]
    blank = np.zeros((240, 320), np.uint8)
    points = np.random.default_rng(0).uniform([-25, -25, 0], [25, 25, 15], (50, 3))
    pair = rectify(blank, blank, *T, points, structure.MODEL)
    axes = pair.view.R_local_view
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert axes[2, 2] < -math.cos(math.radians(10))
    a = pair.view.pixels((points - T[0][:3, 3]) @ axes)
    b = pair.view.shifted(-pair.offset_px).pixels((points - T[1][:3, 3]) @ axes)
    np.testing.assert_allclose(a[:, 1], b[:, 1], atol=1e-9)
    disparity = a[:, 0] - b[:, 0]
    assert (disparity > 0).all()
    assert (disparity < pair.count).all()
    np.testing.assert_allclose(pair.depth_m(disparity), (points - T[0][:3, 3]) @ axes[:, 2])


def test_the_level_ground_is_drawn_with_one_disparity(structure):
    world = structure.World(structure.texture(5))
    T = [structure.pose(0, 0, 90, 10, -5, 70), structure.pose(10, 22, 90, 4, 6, 60)]
    drawn = [world.render(structure.MODEL, t, noise=0) for t in T]
    ground = np.array([[-20.0, -20, 0], [20, 20, 0], [0, 0, 0]])
    pair = rectify(*drawn, *T, ground, structure.MODEL)
    level = np.full(pair.left.shape, pair.view.focal_px * pair.baseline_m / 90 - pair.offset_px, np.float32)
    common = pair.left_seen & seen_in_right(pair, level)
    shift = round(float(level[0, 0]))
    apart = pair.left[:, shift:].astype(float) - pair.right[:, : pair.right.shape[1] - shift]
    assert common.mean() > 0.3
    assert np.corrcoef(pair.left[:, shift:][common[:, shift:]], pair.right[:, :-shift][common[:, shift:]])[0, 1] > 0.97
    assert np.median(abs(apart[common[:, shift:]])) < 8


def test_frames_apart_have_nothing_to_rectify(structure):
    blank = np.zeros((240, 320), np.uint8)
    points = np.array([[0.0, 0, 0], [0, 1, 0]])
    assert rectify(blank, blank, structure.pose(0, 0, 90), structure.pose(0, 900, 90), points, structure.MODEL) is None


def test_what_does_not_move_between_the_frames_is_no_ground(structure):
    """Disparities of none and less, as over waves, would lie at infinity and behind the camera."""
    blank = np.zeros((240, 320), np.uint8)
    ground = np.array([[-20.0, -20, 0], [20, 20, 0], [0, 0, 0]])
    pair = rectify(blank, blank, structure.pose(0, 0, 90), structure.pose(0, 27, 90), ground, structure.MODEL)
    value = np.full(pair.left.shape, pair.view.focal_px * pair.baseline_m / 90 - pair.offset_px, np.float32)
    value[0], value[1] = -pair.offset_px, -pair.offset_px - 3
    seen = np.ones(value.shape, bool)
    points = triangulated(pair, Disparity(value, np.ones_like(value), seen, seen))
    assert len(points.m) == value.size - 2 * value.shape[1]
    assert np.isfinite(points.m).all()
    np.testing.assert_allclose(points.m[:, 2], 0.0, atol=1e-3)
