from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter.propagation import INERTIAL_WALK_MPS_PER_SQRT_S
from visloc_companion.core.velocity.inertial import MAX_GAP_NS, InertialVelocity
from visloc_companion.core.velocity.inertial_bias import ENOUGH, MOST_MPS2, SAFETY, AccelerationBias
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


TAU_S = 20.0


def bias_of(sigma_mps2: float, tau_s: float, walk: float, seed: int, windows: int = 200) -> AccelerationBias:
    """What is learned of an acceleration error of this 1-sigma and correlation time, with white noise (m/s per root second)."""
    rng, bias, dt_s = np.random.default_rng(seed), AccelerationBias(), 0.1
    kept = math.exp(-dt_s / tau_s)
    error, total = sigma_mps2 * rng.standard_normal(2), np.zeros(2)
    for k in range(windows * 50):
        bias.on_sample(round(k * 1e8), (0.0, 0.0), (float(total[0]), float(total[1])), 0.0)
        known = np.array(bias.forward_right_mps2)
        total = total + (error - known) * dt_s + walk * math.sqrt(dt_s) * rng.standard_normal(2)
        error = kept * error + sigma_mps2 * math.sqrt(1 - kept * kept) * rng.standard_normal(2)
    return bias


def learned_sigma(sigma_mps2: float, tau_s: float, walk: float) -> float:
    found = [bias_of(sigma_mps2, tau_s, walk, seed).sigma_mps2(0.2, 0.01, TAU_S) for seed in range(8)]
    return float(np.median(found)) / SAFETY


def test_an_error_that_stays_as_long_as_the_filter_thinks_is_learned_as_it_is() -> None:
    assert learned_sigma(0.15, TAU_S, INERTIAL_WALK_MPS_PER_SQRT_S) == pytest.approx(0.15, rel=0.25)


def test_an_error_that_changes_every_few_seconds_counts_for_more() -> None:
    assert 0.3 < learned_sigma(0.23, 3.5, INERTIAL_WALK_MPS_PER_SQRT_S) < MOST_MPS2


def test_white_noise_that_the_filter_allows_for_is_no_bias() -> None:
    assert learned_sigma(0.0, TAU_S, INERTIAL_WALK_MPS_PER_SQRT_S) < 0.06


def test_a_few_windows_tell_nothing_and_the_sigma_has_bounds() -> None:
    assert bias_of(0.3, TAU_S, 0.0, 1, windows=ENOUGH).sigma_mps2(0.2, 0.01, TAU_S) == 0.2
    assert bias_of(0.3, TAU_S, 0.0, 1, windows=ENOUGH + 2).sigma_mps2(0.2, 0.01, TAU_S) != 0.2
    assert bias_of(0.001, TAU_S, 0.0, 1).sigma_mps2(0.2, 0.05, TAU_S) == 0.05
    assert bias_of(3.0, TAU_S, 0.0, 1).sigma_mps2(0.2, 0.05, TAU_S) == MOST_MPS2


def test_turns_and_interruptions_teach_nothing() -> None:
    bias = AccelerationBias()
    for k in range(20):
        bias.on_sample(round(k * 5.1e9), (0.0, 0.0), (9.0 * k, 0.0), 1.0 * k)
    for k in range(20, 40):
        bias.on_sample(round(k * 5.1e9), (0.0, 0.0), (9.0 * k, 0.0), 1.0)
        bias.interrupted()
    assert bias.forward_right_mps2 == (0.0, 0.0)
