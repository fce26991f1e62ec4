from __future__ import annotations

import math

import numpy as np

from visloc_companion.localise.mapped.ground import LAND_RAD, sigma_slope_rad

PLANE = np.full((20, 30), 112.0, np.float32)


def test_a_surface_model_leaves_no_slope_open():
    hill = PLANE + np.linspace(0, 3, 30, dtype=np.float32)
    assert sigma_slope_rad(hill, 100.0) == 0.0


def test_without_one_the_slope_is_less_certain_the_smaller_the_footprint():
    near, far = (sigma_slope_rad(PLANE, side_m) for side_m in (60.0, 1e6))
    assert math.radians(3.0) < near < math.radians(6.0)
    assert far == LAND_RAD or abs(far - LAND_RAD) < 1e-6
