"""How the error of a reported attitude changes by what pictures show of a turn."""

from __future__ import annotations

import math

import numpy as np

from visloc_companion.geo import se3
from visloc_companion.geo.tilt import TAILS, TURN_SHARE, tilt_gained
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
    np.testing.assert_allclose(np.diag(cov), TAILS * SIGMA_RAD**2 + (TURN_SHARE * angle) ** 2, rtol=1e-6)


def test_the_sign_of_a_quaternion_says_nothing() -> None:
    q = se3.quat_from_euler(0.0, 0.1, 1.0)
    w, x, y, z = reported(q, 0.01, 0.0)
    gained, _ = tilt_gained(q, turn_of(q, q), (-w, -x, -y, -z))
    np.testing.assert_allclose(gained, (0.01, 0.0), atol=1e-4)
