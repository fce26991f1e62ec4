from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.inertial import MAX_GAP_NS, InertialVelocity
from visloc_companion.core.inertial_bias import ENOUGH, AccelerationBias
from visloc_companion.geo.se3 import quat_from_euler, quat_inverse, rotate
from visloc_companion.types import Quat, Vec3

G = 9.80665
STEP_NS = 20_000_000
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


def felt(a_ned: Vec3, q_ned_frd: Quat, bias: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    x, y, z = rotate(quat_inverse(q_ned_frd), (a_ned[0], a_ned[1], a_ned[2] - G))
    return x + bias[0], y + bias[1], z + bias[2]


def fed(inertial: InertialVelocity, from_s: float, to_s: float, a_ned: Vec3, q: Quat, bias: Vec3 = (0.0, 0.0, 0.0)) -> None:
    for k in range(round(from_s * 50), round(to_s * 50)):
        inertial.on_force(k * STEP_NS, felt(a_ned, q, bias), q)


def test_sums_the_acceleration_whatever_the_attitude() -> None:
    inertial, q = InertialVelocity(), quat_from_euler(0.3, -0.2, 2.0)
    fed(inertial, 0.0, 0.1, (1.0, -2.0, 0.5), q)
    inertial.anchor(80_000_000, (5.0, 0.0))
    fed(inertial, 0.1, 2.1, (1.0, -2.0, 0.5), q)
    assert inertial.at(2_080_000_000) == pytest.approx((7.0, -4.0))
    assert inertial.at(1_085_000_000) == pytest.approx((6.005, -2.01))


def test_answers_only_between_anchor_and_a_little_ahead() -> None:
    inertial = InertialVelocity()
    assert inertial.at(0) is None
    inertial.anchor(0, (1.0, 1.0))
    assert inertial.at(0) is None
    fed(inertial, 0.0, 1.0, (0.0, 0.0, 0.0), LEVEL)
    assert inertial.at(500_000_000) is None
    inertial.anchor(500_000_000, (1.0, 1.0))
    assert inertial.at(1_050_000_000) == pytest.approx((1.0, 1.0))
    assert inertial.at(1_500_000_000) is None


def test_a_gap_ends_the_sum_and_a_new_anchor_begins_another() -> None:
    inertial = InertialVelocity()
    fed(inertial, 0.0, 0.5, (1.0, 0.0, 0.0), LEVEL)
    inertial.anchor(400_000_000, (0.0, 0.0))
    late = 480_000_000 + MAX_GAP_NS + 1
    inertial.on_force(late, felt((1.0, 0.0, 0.0), LEVEL), LEVEL)
    assert inertial.at(late) is None
    inertial.anchor(late, (2.0, 0.0))
    assert inertial.at(late + STEP_NS) == pytest.approx((2.02, 0.0))


def test_released_it_has_nothing_to_begin_from() -> None:
    inertial = InertialVelocity()
    fed(inertial, 0.0, 0.5, (1.0, 0.0, 0.0), LEVEL)
    inertial.anchor(400_000_000, (0.0, 0.0))
    inertial.release()
    assert inertial.at(450_000_000) is None


def test_samples_that_are_not_later_are_dropped() -> None:
    inertial = InertialVelocity()
    fed(inertial, 0.0, 0.2, (1.0, 0.0, 0.0), LEVEL)
    inertial.anchor(180_000_000, (0.0, 0.0))
    inertial.on_force(100_000_000, (99.0, 0.0, -G), LEVEL)
    inertial.on_force(180_000_000, (99.0, 0.0, -G), LEVEL)
    fed(inertial, 0.2, 0.3, (1.0, 0.0, 0.0), LEVEL)
    assert inertial.at(280_000_000) == pytest.approx((0.1, 0.0))


def test_a_bias_of_the_body_is_learned_beside_a_velocity_that_is_trusted_and_taken_off_in_any_heading() -> None:
    inertial, bias = InertialVelocity(), (0.3, -0.1, 0.2)
    east = quat_from_euler(0.0, 0.0, math.pi / 2)
    for k in range(60 * 50):
        inertial.on_force(k * STEP_NS, felt((0.0, 0.0, 0.0), east, bias), east)
        if k % 5 == 0:
            inertial.anchor(k * STEP_NS, (0.0, 10.0), teaches=True)
    assert inertial.bias.forward_right_mps2 == pytest.approx((0.3, -0.1), abs=1e-3)
    start = 60 * 50 - 1
    inertial.anchor(start * STEP_NS, (10.0, 0.0))
    fed(inertial, 60.0, 70.0, (0.0, 0.0, 0.0), LEVEL, bias)
    assert inertial.at(69_980_000_000) == pytest.approx((10.0, 0.0), abs=0.01)


def test_the_scatter_of_the_windows_is_the_sigma_and_few_windows_tell_nothing() -> None:
    rng, bias = np.random.default_rng(2), AccelerationBias()
    total, v = np.zeros(2), (0.0, 0.0)
    for k in range(200):
        bias.on_sample(round(k * 5.1e9), v, (float(total[0]), float(total[1])), 0.3)
        if k < ENOUGH:
            assert bias.sigma_mps2(0.5, 0.05) == 0.5
        total += 5.1 * 0.1 * rng.standard_normal(2)
    assert bias.sigma_mps2(0.5, 0.05) == pytest.approx(0.13, rel=0.35)
    assert bias.sigma_mps2(0.5, 0.4) == 0.4


def test_turns_and_interruptions_teach_nothing() -> None:
    bias = AccelerationBias()
    for k in range(20):
        bias.on_sample(round(k * 5.1e9), (0.0, 0.0), (9.0 * k, 0.0), 1.0 * k)
    for k in range(20, 40):
        bias.on_sample(round(k * 5.1e9), (0.0, 0.0), (9.0 * k, 0.0), 1.0)
        bias.interrupted()
    assert bias.forward_right_mps2 == (0.0, 0.0)
