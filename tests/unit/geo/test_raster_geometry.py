import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion.geo.raster import (
    T_map_pix_from_gdal,
    apply_affine,
    compose_affine,
    invert_affine,
    sides_turn_rad,
    square_reach_m,
    window_affine,
)

numbers = st.floats(-100, 100)
affines = (
    st.tuples(*[numbers] * 6)
    .map(lambda t: np.array(t).reshape(2, 3))
    .filter(lambda T: abs(T[0, 0] * T[1, 1] - T[0, 1] * T[1, 0]) > 0.1)
)


def test_gdal_transform_of_the_first_pixel() -> None:
    T = T_map_pix_from_gdal((2.0, 0.0, 1000.0, 0.0, -2.0, 5000.0))
    assert (apply_affine(T, np.array([0.0, 0.0])) == [1001.0, 4999.0]).all()
    turned = (1.2, 0.5, 10.0, 0.4, -1.1, 20.0)
    col, row = 7.5, 3.5
    want = (1.2 * col + 0.5 * row + 10.0, 0.4 * col - 1.1 * row + 20.0)
    assert apply_affine(T_map_pix_from_gdal(turned), np.array([7.0, 3.0])) == pytest.approx(want)


@settings(max_examples=40)
@given(affines, affines, st.tuples(numbers, numbers))
def test_inverse_and_composition(A: np.ndarray, B: np.ndarray, p) -> None:
    point = np.array(p)
    assert apply_affine(compose_affine(A, B), point) == pytest.approx(apply_affine(A, apply_affine(B, point)), abs=1e-6)
    assert apply_affine(invert_affine(A), apply_affine(A, point)) == pytest.approx(point, abs=1e-6)


def test_singular_affine_has_no_inverse() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        invert_affine(np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0]]))


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 90.0, -135.0])
def test_window_points_where_it_is_told(heading_deg: float) -> None:
    north_up = np.array([[0.0, 1.0], [1.0, 0.0]])
    T = window_affine((500.0, 900.0), (11, 7), north_up, 2.0, math.radians(heading_deg))
    centre = apply_affine(T, np.array([5.0, 3.0]))
    assert centre == pytest.approx((500.0, 900.0))
    up = apply_affine(T, np.array([5.0, 2.0])) - centre
    assert up == pytest.approx((2 * math.sin(math.radians(heading_deg)), 2 * math.cos(math.radians(heading_deg))))
    right = apply_affine(T, np.array([6.0, 3.0])) - centre
    assert right == pytest.approx((2 * math.cos(math.radians(heading_deg)), -2 * math.sin(math.radians(heading_deg))))


@pytest.mark.parametrize(("heading_deg", "turn_deg"), [(0.0, 0.0), (30.0, 30.0), (60.0, -30.0), (90.0, 0.0), (-100.0, -10.0)])
def test_sides_turn_from_north_and_east(heading_deg: float, turn_deg: float) -> None:
    """Whichever side is the upper one, and in a grid that itself is turned by 20 degrees and of half metres."""
    c, s = math.cos(math.radians(20.0)), math.sin(math.radians(20.0))
    J_map_ne = 2 * np.array([[-s, c], [c, s]])
    T = window_affine((500.0, 900.0), (11, 7), J_map_ne, 2.0, math.radians(heading_deg))
    assert math.degrees(sides_turn_rad(T, J_map_ne)) == pytest.approx(turn_deg)


def test_the_square_that_a_turned_raster_holds() -> None:
    """100 x 60 pixels of 2 m: 60 m to the nearer sides along them, 60 / sqrt(2) with sides across, less beside the middle."""
    J_map_ne = np.array([[0.0, 1.0], [1.0, 0.0]])
    turn_rad, middle = math.radians(30.0), np.array([500.0, 900.0])
    T = window_affine((500.0, 900.0), (100, 60), J_map_ne, 2.0, turn_rad)
    up = np.array([math.sin(turn_rad), math.cos(turn_rad)])
    assert square_reach_m(T, (100, 60), J_map_ne, middle, turn_rad) == pytest.approx(60.0)
    assert square_reach_m(T, (100, 60), J_map_ne, middle, turn_rad + math.pi / 4) == pytest.approx(60.0 / math.sqrt(2.0))
    assert square_reach_m(T, (100, 60), J_map_ne, middle + 25.0 * up, turn_rad) == pytest.approx(35.0)
    assert square_reach_m(T, (100, 60), J_map_ne, middle + 70.0 * up, turn_rad) == pytest.approx(-10.0)
