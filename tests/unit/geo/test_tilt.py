"""How the error of a reported attitude changes by what pictures show of a turn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visloc_companion.geo import se3
from visloc_companion.geo.tilt import TURN_SHARE, by_camera, composed, heading_by_camera, heading_gained, tilt_gained
from visloc_companion.types import Quat, Turn

SIGMA_RAD = math.radians(0.1)
COV = ((SIGMA_RAD**2, 0.0, 0.0), (0.0, SIGMA_RAD**2, 0.0), (0.0, 0.0, SIGMA_RAD**2))


def turn_of(before: Quat, after: Quat) -> Turn:
    return Turn(0, 250_000_000, se3.quat_multiply(se3.quat_inverse(before), after), COV)


def reported(true: Quat, north_rad: float, east_rad: float) -> Quat:
    """An attitude that the rotation about north and east sets right."""
    return se3.quat_multiply(se3.quat_inverse(se3.quat_from_vector((north_rad, east_rad, 0.0))), true)


def test_what_the_reported_attitude_gains_is_told_in_any_attitude() -> None:
    before, after = se3.quat_from_euler(0.2, -0.1, 2.0), se3.quat_from_euler(-0.1, 0.15, 2.3)
    gained, cov = tilt_gained(reported(before, 0.010, -0.004), turn_of(before, after), reported(after, 0.022, 0.003))
    np.testing.assert_allclose(gained, (0.012, 0.007), atol=3e-4)
    angle = se3.angle_between(before, after)
    np.testing.assert_allclose(np.diag(cov), SIGMA_RAD**2 + (TURN_SHARE * angle) ** 2, rtol=1e-6)


def test_what_the_reported_heading_gains_is_told_in_any_attitude() -> None:
    def off(true: Quat, clockwise_rad: float) -> Quat:
        return se3.quat_multiply(se3.quat_from_vector((0.0, 0.0, -clockwise_rad)), true)

    before, after = se3.quat_from_euler(0.6, -0.4, 2.0), se3.quat_from_euler(0.5, -0.3, 2.3)
    assert heading_gained(off(before, 0.05), turn_of(before, after), off(after, 0.02)) == pytest.approx(-0.03, abs=1e-5)


def test_the_sign_of_a_quaternion_says_nothing() -> None:
    q = se3.quat_from_euler(0.0, 0.1, 1.0)
    w, x, y, z = reported(q, 0.01, 0.0)
    gained, _ = tilt_gained(q, turn_of(q, q), (-w, -x, -y, -z))
    np.testing.assert_allclose(gained, (0.01, 0.0), atol=1e-4)


def test_what_a_wrong_camera_adds_to_a_turn_is_told_in_any_attitude() -> None:
    """A lens longer by a share sees turns across its axis larger; a camera turned about its axis sees them about others."""
    lens, yaw = 0.01, 0.012
    before, after = se3.quat_from_euler(0.2, -0.1, 2.0), se3.quat_from_euler(-0.1, 0.15, 2.3)
    w, x, y, z = turn_of(before, after).q_from_to
    half = math.atan2(math.hypot(x, y, z), w) / math.hypot(x, y, z)
    across = 2 * half * np.array([x, y])
    longer = across * (1 + lens)
    seen = (longer[0] + yaw * longer[1], longer[1] - yaw * longer[0], 2 * half * z)  # in a camera turned by yaw to the right
    gained, _ = tilt_gained(before, replace(turn_of(before, after), q_from_to=se3.quat_from_vector(seen)), after)
    np.testing.assert_allclose(by_camera(before, after) @ (lens, yaw), gained, atol=0.06 * np.abs(gained).max())
    by_heading = heading_gained(before, replace(turn_of(before, after), q_from_to=se3.quat_from_vector(seen)), after)
    assert float(np.dot(heading_by_camera(before, after), (lens, yaw))) == pytest.approx(by_heading, abs=0.06 * abs(gained).max())


def test_turns_that_follow_each_other_are_one() -> None:
    a, b, c = se3.quat_from_euler(0.2, -0.1, 2.0), se3.quat_from_euler(-0.1, 0.15, 3.5), se3.quat_from_euler(0.0, 0.1, 4.0)
    sure = math.radians(0.01) ** 2
    along = ((SIGMA_RAD**2, 0.0, 0.0), (0.0, sure, 0.0), (0.0, 0.0, sure))
    first, second = replace(turn_of(a, b), cov_rad2=along), replace(turn_of(b, c), t_from_ns=250_000_000, t_to_ns=500_000_000)
    both = composed(first, second)
    assert (both.t_from_ns, both.t_to_ns) == (0, 500_000_000)
    assert se3.angle_between(both.q_from_to, turn_of(a, c).q_from_to) < 1e-9
    ahead = se3.R_from_quat(turn_of(b, c).q_from_to).T[:, 0]  # the first turn's poor axis in those of the last frame
    expected = np.array(COV) + sure * np.eye(3) + (SIGMA_RAD**2 - sure) * np.outer(ahead, ahead)
    np.testing.assert_allclose(both.cov_rad2, expected, atol=1e-12)
