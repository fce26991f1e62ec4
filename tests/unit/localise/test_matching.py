"""Candidates are told apart by the ground that they look at."""

from __future__ import annotations

import numpy as np

from visloc_companion.localise.descent import Descended
from visloc_companion.localise.matching import distinct
from visloc_companion.localise.ortho_rectify import CameraPose
from visloc_companion.localise.pose import to_view, turned_about_view

UP_M, GROUND_UP_M = 150.0, 30.0
NADIR = CameraPose(np.array([5.0, -8.0, -UP_M]), np.eye(3))


def candidate(pose, score):
    return Descended(pose, score, np.zeros((6, 6)))


def view_ne_m(pose):
    return (pose.p_ned_m + to_view(pose, GROUND_UP_M))[:2]


def test_two_tilts_at_the_same_ground_are_one_place():
    tilted = turned_about_view(NADIR, GROUND_UP_M, np.array([0.0, 0.1, 0.0]))
    assert np.hypot(*(tilted.p_ned_m - NADIR.p_ned_m)[:2]) > 10.0
    better, worse = candidate(NADIR, 0.5), candidate(tilted, 0.4)
    assert distinct([better, worse], 2.0, view_ne_m) == [better]


def test_other_ground_from_the_same_position_is_another_place():
    elsewhere = turned_about_view(NADIR, GROUND_UP_M, np.array([0.0, 0.1, 0.0]))
    elsewhere = CameraPose(NADIR.p_ned_m, elsewhere.R_ned_cam)
    both = [candidate(NADIR, 0.5), candidate(elsewhere, 0.4)]
    assert distinct(both, 2.0, view_ne_m) == both
    assert distinct(both, 50.0, view_ne_m) == both[:1]
