from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.geo.camera import R_FRD_CAM
from visloc_companion.geo.se3 import R_from_quat, quat_from_euler
from visloc_companion.localise.candidates.descent import Descended
from visloc_companion.localise.candidates.tilt_starts import likeliest, starts, tilt_is_known
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import heading_and_tilt, turned_about_view

GROUND_UP_M = 40.0


def _pose(roll: float, pitch: float) -> CameraPose:
    return CameraPose(np.array([10.0, -20.0, -150.0]), R_from_quat(quat_from_euler(roll, pitch, 0.7)) @ R_FRD_CAM)


def _looked_at(pose: CameraPose) -> np.ndarray:
    axis = pose.R_ned_cam[:, 2]
    return pose.p_ned_m + axis * ((-GROUND_UP_M - pose.p_ned_m[2]) / axis[2])


def test_a_known_tilt_has_one_start():
    pose = _pose(0.02, 0.1)
    assert tilt_is_known(math.radians(1.0))
    assert starts(pose, GROUND_UP_M, math.radians(1.0)) == [pose]


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.3)])
def test_an_unknown_tilt_has_nine_that_see_the_same_ground_from_the_same_distance(tilt):
    pose = _pose(*tilt)
    found = starts(pose, GROUND_UP_M, math.radians(6.0))
    assert len(found) == 9
    for each in found:
        np.testing.assert_allclose(_looked_at(each), _looked_at(pose), atol=1e-6)
    tilts = np.array([heading_and_tilt(each.R_ned_cam, pose.R_ned_cam)[1] for each in found])
    assert np.abs(tilts).max() == pytest.approx(math.radians(6.0), abs=0.01)
    assert len(np.unique(tilts.round(2), axis=0)) == 9


def test_turning_by_nothing_changes_nothing():
    pose = _pose(0.1, 0.2)
    same = turned_about_view(pose, GROUND_UP_M, np.zeros(3))
    np.testing.assert_allclose(same.p_ned_m, pose.p_ned_m, atol=1e-9)
    np.testing.assert_allclose(same.R_ned_cam, pose.R_ned_cam, atol=1e-12)


def test_a_slightly_better_score_does_not_pay_for_an_unlikely_tilt():
    level, tilted = _pose(0.0, 0.0), _pose(0.3, 0.0)
    ends = [Descended(level, 0.50, np.eye(6)), Descended(tilted, 0.51, np.eye(6))]
    assert likeliest(ends, level.R_ned_cam, math.radians(6.0), 50.0) is ends[0]
    assert likeliest(ends, level.R_ned_cam, math.radians(60.0), 50.0) is ends[1]
