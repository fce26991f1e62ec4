from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.localise.registration.similarity import about, moved, scale_of, tilt_of, turned, with_linear, yaw_of

RNG = np.random.default_rng(6)


def test_about_turns_and_scales_about_its_centre_and_shifts_it():
    centre, shift = np.array([10.0, -4.0, 3.0]), np.array([1.0, 2.0, 0.5])
    T = about(centre, np.radians(90), 2.0, shift)
    np.testing.assert_allclose(moved(T, centre), centre + shift)
    np.testing.assert_allclose(moved(T, centre + np.array([1.0, 0, 0])), centre + shift + np.array([0, 2.0, 0]), atol=1e-12)
    assert (yaw_of(T), scale_of(T)) == pytest.approx((np.radians(90), 2.0))


def test_turned_is_a_rotation_whose_small_angles_are_read_back():
    vector = np.array([0.02, -0.03, 0.4])
    R = turned(*vector)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R @ vector, vector, atol=1e-12)
    T = with_linear(1.5 * turned(0.02, -0.03, 0.0), np.zeros(3), np.ones(3))
    assert tilt_of(T) == pytest.approx((0.02, -0.03), abs=1e-4)
    np.testing.assert_array_equal(turned(0.0, 0.0, 0.0), np.eye(3))


def test_with_linear_takes_the_one_point_to_the_other():
    linear = 1.2 * turned(*RNG.normal(size=3))
    here, there = RNG.normal(size=(2, 3))
    np.testing.assert_allclose(moved(with_linear(linear, here, there), here), there)
