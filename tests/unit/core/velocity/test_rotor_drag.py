from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visloc_companion.core.velocity.rotor_drag import Felt, by_state, by_velocity, force_mps2, velocity_ne_mps
from visloc_companion.geo import se3
from visloc_companion.types import FloatArray

STATE = np.array([0.25, 0.03, 2.0, -4.0, 0.05, -0.1])
SPEED, LEAN = st.floats(-20.0, 20.0), st.floats(-0.6, 0.6)


def axes(roll: float, pitch: float, yaw: float) -> FloatArray:
    return np.asarray(se3.R_from_quat(se3.quat_from_euler(roll, pitch, yaw))[:, :2].T)


@given(SPEED, SPEED, st.floats(-5.0, 5.0), LEAN, LEAN, st.floats(-3.1, 3.1))
def test_the_velocity_that_was_felt_is_found_again(
    north: float, east: float, down: float, roll: float, pitch: float, yaw: float
) -> None:
    along = axes(roll, pitch, yaw)
    felt = Felt(0, force_mps2(STATE, along, (north, east, down)), along)
    assert velocity_ne_mps(STATE, felt, down) == pytest.approx((north, east), abs=1e-6)


def test_still_air_pushes_back_against_the_way_flown() -> None:
    still = np.array([0.25, 0.03, 0.0, 0.0, 0.0, 0.0])
    assert force_mps2(still, axes(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)) == pytest.approx([-5.5, 0.0])
    assert force_mps2(still, axes(0.0, 0.0, np.pi / 2), (10.0, 0.0, 0.0)) == pytest.approx([0.0, 5.5])


def test_a_wind_is_felt_at_rest_as_from_a_flight_against_it() -> None:
    along = axes(0.0, 0.0, 0.7)
    air = np.array([0.25, 0.03, 3.0, 1.0, 0.0, 0.0])
    still = np.array([0.25, 0.03, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(force_mps2(air, along, (0.0, 0.0, 0.0)), force_mps2(still, along, (-3.0, -1.0, 0.0)))


def test_its_derivatives_are_those_of_differences() -> None:
    along, v, step = axes(0.2, -0.4, 1.0), (7.0, 3.0, -1.0), 1e-6
    for k in range(6):
        more = STATE.copy()
        more[k] += step
        slope = (force_mps2(more, along, v) - force_mps2(STATE, along, v)) / step
        np.testing.assert_allclose(by_state(STATE, along, v)[:, k], slope, atol=1e-5)
    for k, changed in enumerate(((v[0] + step, v[1], v[2]), (v[0], v[1] + step, v[2]))):
        slope = (force_mps2(STATE, along, changed) - force_mps2(STATE, along, v)) / step
        np.testing.assert_allclose(by_velocity(STATE, along, v)[:, k], slope, atol=1e-5)


@pytest.mark.parametrize("k1", [-0.1, 0.0, 0.03])
def test_a_force_that_hardly_changes_with_the_velocity_tells_none(k1: float) -> None:
    state = np.array([k1, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert velocity_ne_mps(state, Felt(0, np.array([-0.2, 0.0]), axes(0.0, 0.0, 0.0)), 0.0) is None


def test_rotors_on_edge_tell_no_level_velocity() -> None:
    along = axes(0.0, 1.5, 0.0)
    assert velocity_ne_mps(STATE, Felt(0, force_mps2(STATE, along, (5.0, 0.0, 0.0)), along), 0.0) is None
