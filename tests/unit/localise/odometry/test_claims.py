"""What an answer of the odometry claims for a wrong lens."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visloc_companion.geo.camera import FOCAL_SHARE
from visloc_companion.localise.odometry.claims import COMMON_PX, odometry_of
from visloc_companion.localise.odometry.solve import Motion
from visloc_companion.types import FloatArray

HEIGHT_M, FOCAL_PX, OWN_M = 100.0, 500.0, 0.1


def answered(by_lens_m: FloatArray) -> Any:
    """Ten metres north, seen to OWN_M, of a camera that adds `by_lens_m` for each share by which its lens is longer."""
    picture = SimpleNamespace(K=np.diag([FOCAL_PX, FOCAL_PX, 1.0]))
    sight: Any = SimpleNamespace(t_ns=0, sigma_yaw_rad=0.0, sigma_up_m=0.0, sigma_height_m=0.0)
    key: Any = SimpleNamespace(sight=sight, picture=picture, height_m=HEIGHT_M, mapped=True)
    own, none = OWN_M**2 * np.eye(3), np.zeros((3, 3))
    motion = Motion(np.array([10.0, 0, 0]), own, none, np.ones(50, np.bool_), 0.1, 1.0, np.zeros(3), by_lens_m)
    return odometry_of(key, sight, motion, closes=True)


def test_a_lens_that_makes_the_ground_near_is_claimed_along_the_way() -> None:
    step = answered(np.array([10.0, 0.0, 0.0]))
    (nn, _), (_, ee) = step.odometry.cov_ne_m2
    common_m = COMMON_PX * HEIGHT_M / FOCAL_PX
    assert nn == pytest.approx(OWN_M**2 + common_m**2 + (10 * FOCAL_SHARE) ** 2)
    assert ee == pytest.approx(OWN_M**2 + common_m**2)
    assert step.odometry.per_focal_ne_m == (0.0, 0.0)
    assert step.sigma_down_m == pytest.approx(OWN_M)


def test_a_lens_that_takes_a_turn_for_a_climb_is_claimed_in_the_climb() -> None:
    step = answered(np.array([10.0, 30.0, 20.0]))
    assert step.sigma_down_m == pytest.approx(math.hypot(OWN_M, 20 * FOCAL_SHARE))
    assert step.odometry.per_focal_ne_m == pytest.approx((0.0, 30.0))
