"""Descents that end early because of others, and on features that are resampled from one pass."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from visloc_companion.localise import align
from visloc_companion.localise.candidates.descent import Descended, Rivals, descend, descend_resampled
from visloc_companion.localise.candidates.frame_features import ForEachPose
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.localise.frame import FrameLevel
from visloc_companion.localise.mapped.window import thinned
from visloc_companion.localise.ortho_rectify import CameraPose, MapGrid, ground_homography
from visloc_companion.localise.pose import PriorTerm
from visloc_companion.types import FloatArray

GSD_M, SIDE_PX = 1.0, 128
NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TRUTH = CameraPose(np.array([1.5, -2.0, -100.0]), NADIR)
K = np.array([[110.0, 0.0, 47.5], [0.0, 110.0, 47.5], [0.0, 0.0, 1.0]])
A_NE_PIX: FloatArray = np.array([[0.0, -GSD_M, SIDE_PX / 2], [GSD_M, 0.0, -SIDE_PX / 2]])


def _scene() -> tuple[MapGrid, ForEachPose]:
    """A map of noise with edges, and the frame that TRUTH takes of it."""
    rng = np.random.default_rng(2)
    image = cv2.GaussianBlur(rng.uniform(0, 255, (SIDE_PX, SIDE_PX)).astype(np.float32), (0, 0), 2.0) * 4 - 380
    flat = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    grid = MapGrid(GRADIENT(image, flat == 0), flat + 1, flat, A_NE_PIX, GSD_M)
    H = ground_homography(K, TRUTH, A_NE_PIX, 0.0)
    frame = np.asarray(cv2.warpPerspective(image, H, (96, 96), flags=cv2.INTER_LINEAR), dtype=np.float32)
    return grid, ForEachPose(FrameLevel(frame, np.full(frame.shape, 255, np.uint8), K), GRADIENT)


def _ended(pose: CameraPose, score: float) -> Descended:
    return Descended(pose, score, np.zeros((6, 6)))


def _prior() -> PriorTerm:
    return PriorTerm(NADIR, math.radians(0.5), math.radians(3), 100.0, 4.0)


@pytest.mark.parametrize("stride", [1, 2])
def test_features_of_one_pass_lead_where_those_of_every_pose_do(stride: int) -> None:
    """Also on every other row and column."""
    grid, frame = _scene()
    start = align.moved(TRUTH, np.array([2.0, -1.5, 1.0, 0.0, 0.0, math.radians(1.5)]))
    full = descend(frame, start, grid, align.prepare(grid), _prior(), 6)
    thin = thinned(grid, stride)
    end, joined = descend_resampled(frame.about(start, thin, stride), start, thin, align.prepare(grid, stride), _prior(), 6)
    assert not joined
    assert end.score == pytest.approx(full.score, abs=0.03)
    for found in (full, end):
        assert np.abs(found.pose.p_ned_m[:2] - TRUTH.p_ned_m[:2]).max() < 0.5 * GSD_M


def test_a_descent_that_comes_to_where_another_ended_says_so() -> None:
    """What is found twice is one candidate."""
    grid, frame = _scene()
    start = align.moved(TRUTH, np.array([2.0, -1.5, 0.0, 0.0, 0.0, 0.0]))
    rivals = Rivals([_ended(TRUTH, 0.5)], 1.0 * GSD_M)
    _, joined = descend_resampled(frame.about(start, grid, 1), start, grid, align.prepare(grid), _prior(), 6, rivals)
    assert joined


def test_a_descent_far_behind_the_best_is_given_up_where_it_starts() -> None:
    """A start far from the truth scores near zero."""
    grid, frame = _scene()
    start = align.moved(TRUTH, np.array([22.0, 17.0, 0.0, 0.0, 0.0, 0.0]))
    rivals = Rivals([_ended(TRUTH, 0.9)], GSD_M)
    end, joined = descend_resampled(frame.about(start, grid, 1), start, grid, align.prepare(grid), _prior(), 6, rivals)
    assert not joined
    assert end.pose is start


def test_what_is_hopeless_depends_on_the_step() -> None:
    """A start may be worse than what must have been reached after a step; without others nothing is hopeless."""
    rivals = Rivals([_ended(TRUTH, 0.4), _ended(TRUTH, 0.8)], 1.0)
    assert not rivals.hopeless(0.45, 0)
    assert rivals.hopeless(0.45, 1)
    assert not rivals.hopeless(0.6, 5)
    assert not Rivals([], 1.0).hopeless(0.0, 3)
