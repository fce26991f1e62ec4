"""What a turn that pictures show makes of the tilt of attitudes that were reported for them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from visloc_companion.geo import se3
from visloc_companion.types import FloatArray, Quat, Turn

TURN_SHARE = 0.02
"""Turn and reported attitudes disagree by this share of the turn (1-sigma): focal length and mounting."""


def tilt_gained(q_before: Quat, turn: Turn, q_now: Quat) -> tuple[FloatArray, FloatArray]:
    """By how much (2,) the rotation about north and east that sets the reported attitude's tilt right has changed between the two
    frames of a turn, and its covariance (2, 2), rad and rad².

    `q_before`, `q_now`: NED from the camera's body as reported at `t_from_ns` and `t_to_ns`. The rotations are small.
    """
    true_now = se3.quat_multiply(q_before, turn.q_from_to)
    w, x, y, _ = se3.quat_multiply(true_now, se3.quat_inverse(q_now))
    gained = math.copysign(2.0, w) * np.array([x, y])
    R = se3.R_from_quat(q_now)
    own = (TURN_SHARE * se3.angle_between(turn.q_from_to, (1.0, 0.0, 0.0, 0.0))) ** 2
    return gained, (R @ np.array(turn.cov_rad2) @ R.T)[:2, :2] + own * np.eye(2)


def composed(first: Turn, second: Turn) -> Turn:
    """The turn that two make which follow each other; `cov_rad2` of each is about the axes of its later frame."""
    R = se3.R_from_quat(second.q_from_to)
    cov = R.T @ np.array(first.cov_rad2) @ R + np.array(second.cov_rad2)
    xx, xy, xz, yy, yz, zz = (float(cov[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    q = se3.quat_multiply(first.q_from_to, second.q_from_to)
    return replace(second, t_from_ns=first.t_from_ns, q_from_to=q, cov_rad2=((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
