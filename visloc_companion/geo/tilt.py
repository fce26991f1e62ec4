"""What a turn that pictures show makes of the tilt and heading of attitudes that were reported for them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.geo import se3
from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.types import FloatArray, Quat, Turn, Vec2

TURN_SHARE = 0.003
"""Turn and reported attitudes disagree by this share of the turn (1-sigma), beside what is wrong with the camera, ..."""
CAMERA_SIGMA = (FOCAL_SHARE, math.radians(1.0))
"""... whose focal length (a share) and mounting about its axis (rad) are off by so much (1-sigma)."""

LAND_RAD = math.radians(1.5)
"""1-sigma of the slope of the land on one axis (localise/mapped/ground.py): a picture of ground whose heights are not known tells
the tilt no better."""


def tilt_gained(q_before: Quat, turn: Turn, q_now: Quat) -> tuple[FloatArray, FloatArray]:
    """By how much (2,) the rotation about north and east that sets the reported attitude's tilt right has changed between the two
    frames of a turn, and its covariance (2, 2), rad and rad², of a camera that is what it is taken for.

    `q_before`, `q_now`: NED from the camera's body as reported at `t_from_ns` and `t_to_ns`. The rotations are small.
    """
    true_now = se3.quat_multiply(q_before, turn.q_from_to)
    gained = _small(se3.quat_multiply(true_now, se3.quat_inverse(q_now)))[:2]
    R = se3.R_from_quat(q_now)
    own = (TURN_SHARE * se3.angle_between(turn.q_from_to, (1.0, 0.0, 0.0, 0.0))) ** 2
    return gained, (R @ np.array(turn.cov_rad2) @ R.T)[:2, :2] + own * np.eye(2)


def heading_gained(q_before: Quat, turn: Turn, q_now: Quat) -> float:
    """The same of the rotation about the vertical (rad, clockwise) that sets the reported heading right."""
    true_now = se3.quat_multiply(q_before, turn.q_from_to)
    return float(_small(se3.quat_multiply(true_now, se3.quat_inverse(q_now)))[2])


def by_camera(q_before: Quat, q_now: Quat) -> FloatArray:
    """(2, 2) what is wrong with the rotation gained about north (first row) and east: for each share by which the lens is longer
    than calibrated, which makes turns across the optical axis too large, and for each radian by which the camera is turned right
    about that axis, so that its axes are not what they are taken for.

    By the turn that was reported: what pictures see beyond it is small, and is what the attitude's error gained.
    """
    return _by_camera(q_before, q_now)[:2]


def heading_by_camera(q_before: Quat, q_now: Quat) -> Vec2:
    """The same of the rotation about the vertical, rad: for each share of the lens, for each radian about the axis."""
    by_lens, by_axis = _by_camera(q_before, q_now)[2].tolist()
    return by_lens, by_axis


def _by_camera(q_before: Quat, q_now: Quat) -> FloatArray:
    """(3, 2) about north, east and down."""
    x, y, z = _small(se3.quat_multiply(se3.quat_inverse(q_before), q_now)).tolist()
    R_midway = se3.R_from_quat(se3.quat_multiply(q_before, se3.quat_from_vector((x / 2, y / 2, z / 2))))
    return np.asarray(R_midway @ [[x, y], [y, -x], [0.0, 0.0]])


def composed(first: Turn, second: Turn) -> Turn:
    """The turn that two make which follow each other; `cov_rad2` of each is about the axes of its later frame."""
    R = se3.R_from_quat(second.q_from_to)
    cov = R.T @ np.array(first.cov_rad2) @ R + np.array(second.cov_rad2)
    xx, xy, xz, yy, yz, zz = (float(cov[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    q = se3.quat_multiply(first.q_from_to, second.q_from_to)
    return replace(second, t_from_ns=first.t_from_ns, q_from_to=q, cov_rad2=((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def _small(q: Quat) -> FloatArray:
    """(3,) a small rotation as a vector, rad."""
    w, x, y, z = q
    return math.copysign(2.0, w) * np.array([x, y, z])
