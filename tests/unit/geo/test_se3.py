import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visloc_companion.geo.se3 import (
    R_from_quat,
    angle_between,
    body_rates,
    down_axis,
    euler_from_quat,
    normalised,
    plus,
    quat_from_euler,
    quat_from_R,
    quat_from_vector,
    quat_inverse,
    quat_multiply,
    rotate,
    slerp,
    vector_from_quat,
    wrap_pi,
)

ANGLE = st.floats(-math.pi, math.pi)
quats = st.builds(quat_from_euler, ANGLE, st.floats(-math.pi / 2, math.pi / 2), ANGLE)


@settings(max_examples=40)
@given(st.floats(-1000, 1000))
def test_wrapped_angle_is_the_same_direction(angle: float) -> None:
    wrapped = wrap_pi(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


def test_half_turns_are_positive() -> None:
    assert wrap_pi(math.pi) == math.pi == wrap_pi(-math.pi) == wrap_pi(3 * math.pi)


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0.0, 0.0, 1.0)])
def test_no_quaternion_is_refused(q) -> None:
    with pytest.raises(ValueError, match="not a quaternion"):
        normalised(q)


def test_sign_is_settled() -> None:
    assert normalised((-2.0, 0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)
    assert normalised((-1.0, 1.0, 0.0, 0.0)) == pytest.approx((math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0))


@pytest.mark.parametrize(
    ("angles_deg", "forward_ned"),
    [
        ((0, 0, 90), (0, 1, 0)),
        ((0, 90, 0), (0, 0, -1)),
        ((90, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (1, 0, 0)),
        ((10, 45, 180), (-1, 0, -1)),
    ],
)
def test_where_the_nose_points(angles_deg, forward_ned) -> None:
    nose = rotate(quat_from_euler(*np.radians(angles_deg)), (1.0, 0.0, 0.0))
    assert nose == pytest.approx(tuple(np.array(forward_ned) / np.linalg.norm(forward_ned)), abs=1e-12)


def test_roll_lowers_the_right_wing() -> None:
    assert rotate(quat_from_euler(math.radians(30), 0.0, 0.0), (0.0, 1.0, 0.0)) == pytest.approx(
        (0.0, math.cos(math.pi / 6), 0.5)
    )


@settings(max_examples=40)
@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_euler_there_and_back(roll: float, pitch: float, yaw: float) -> None:
    back = euler_from_quat(quat_from_euler(roll, pitch, yaw))
    assert back[1] == pytest.approx(pitch, abs=1e-9)
    for got, want in ((back[0], roll), (back[2], yaw)):
        assert abs(wrap_pi(got - want)) < 1e-9


def test_gimbal_lock_stays_a_number() -> None:
    for pitch in (math.pi / 2, -math.pi / 2):
        assert euler_from_quat(quat_from_euler(0.3, pitch, 0.7))[1] == pytest.approx(pitch, abs=1e-6)


@settings(max_examples=40)
@given(quats, quats)
def test_product_is_composition(a, b) -> None:
    assert R_from_quat(quat_multiply(a, b)) == pytest.approx(R_from_quat(a) @ R_from_quat(b), abs=1e-12)
    assert R_from_quat(quat_inverse(a)) == pytest.approx(R_from_quat(a).T, abs=1e-12)


@settings(max_examples=40)
@given(quats)
def test_matrix_there_and_back(q) -> None:
    R = R_from_quat(q)
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert angle_between(quat_from_R(R), q) < 1e-7


@pytest.mark.parametrize("axis", [(1.0, 0.1, 0.2), (0.1, 1.0, 0.2), (0.1, 0.2, 1.0)])
@pytest.mark.parametrize("angle", [0.1, 3.1, math.pi])
def test_matrices_of_half_turns(axis, angle: float) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    q = normalised((math.cos(angle / 2), *(float(c) for c in math.sin(angle / 2) * unit)))
    assert angle_between(quat_from_R(R_from_quat(q)), q) < 1e-7


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-10, 0.0, 0.0), (0.02, -0.01, 0.3), (-2.0, 1.0, 0.5)])
def test_a_vector_turns_about_itself_by_its_length(vector: tuple[float, float, float]) -> None:
    q = quat_from_vector(vector)
    assert R_from_quat(q) == pytest.approx(cv2.Rodrigues(np.array(vector))[0], abs=1e-12)
    assert vector_from_quat(q) == pytest.approx(vector, abs=1e-12)
    assert vector_from_quat((-q[0], -q[1], -q[2], -q[3])) == pytest.approx(vector, abs=1e-12)


@settings(max_examples=40)
@given(quats, quats, st.floats(0, 1))
def test_slerp_divides_the_angle(a, b, share: float) -> None:
    whole = angle_between(a, b)
    if whole > 3.1:
        return
    middle = slerp(a, b, share)
    assert angle_between(a, middle) == pytest.approx(share * whole, abs=2e-6)
    assert angle_between(middle, b) == pytest.approx((1 - share) * whole, abs=2e-6)


def test_slerp_takes_the_shorter_arc() -> None:
    a, b = quat_from_euler(0, 0, math.radians(170)), quat_from_euler(0, 0, math.radians(-170))
    assert abs(euler_from_quat(slerp(a, b, 0.5))[2]) == pytest.approx(math.pi)
    c = quat_from_euler(0, 0, math.radians(20))
    assert slerp(c, c, 0.3) == pytest.approx(c)


@settings(max_examples=40)
@given(quats, st.tuples(*[st.floats(-2.0, 2.0)] * 3), st.floats(0.01, 1.0))
def test_body_rates_turn_one_attitude_into_the_next(before, rates_radps, dt_s: float) -> None:
    after = quat_multiply(before, quat_from_vector(tuple(rate * dt_s for rate in rates_radps)))
    assert body_rates(before, after, dt_s) == pytest.approx(rates_radps, abs=1e-6)


def test_vectors_are_added_axis_by_axis() -> None:
    assert plus((1.0, -2.0, 3.0), (10.0, 20.0, -3.0)) == (11.0, 18.0, 0.0)


def test_the_down_axis_is_the_third_column_to_the_last_bit() -> None:
    q = quat_from_euler(0.3, -0.7, 2.1)
    assert down_axis(q) == tuple(R_from_quat(q)[:, 2].tolist())
