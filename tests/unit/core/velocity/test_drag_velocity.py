from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.velocity.air_velocity import AirVelocity
from visloc_companion.core.velocity.drag_velocity import (
    BIAS_WALK_MPS2_PER_SQRT_S,
    CHOSEN_AFTER,
    ENOUGH,
    GATED_IN_A_ROW,
    DragLearner,
    _Hypothesis,
)
from visloc_companion.core.velocity.rotor_drag import BIAS, Felt, force_mps2
from visloc_companion.geo import se3
from visloc_companion.types import FloatArray, Vec3

S = 1_000_000_000
EXACT = np.zeros((2, 2))
HEADINGS = (0.0, 1.6, 3.1, -1.5)
TRUE = np.array([0.25, 0.02, 3.0, -4.0, 0.05, -0.05])


def second(t_s: int, yaw: float, speed: float, state: FloatArray = TRUE, noise: FloatArray | None = None) -> tuple[Felt, Vec3]:
    """Flight along the heading, leaning forward by what the drag asks for."""
    v = (speed * np.cos(yaw), speed * np.sin(yaw), 0.0)
    along = se3.R_from_quat(se3.quat_from_euler(0.0, -0.03 * speed, yaw))[:, :2].T
    force = force_mps2(state, along, v) + (0.0 if noise is None else noise)
    return Felt(t_s * S, force, np.asarray(along)), v


def taught(learner: DragLearner, seconds: range, rng: np.random.Generator, state: FloatArray = TRUE) -> None:
    """Legs of 15 s at 10 m/s in turn, each begun with a stop."""
    for t in seconds:
        speed = min(10.0, 2.0 * (t % 15))
        learner.learn(*second(t, HEADINGS[t // 15 % 4], speed, state, 0.1 * rng.standard_normal(2)), EXACT)


def told(learner: DragLearner, t_s: int, yaw: float, speed: float = 10.0, state: FloatArray = TRUE) -> AirVelocity:
    found = learner.velocity(*second(t_s, yaw, speed, state))
    assert found is not None
    return found


def test_a_velocity_is_told_as_well_as_it_claims() -> None:
    squares = []
    for seed in range(20):
        learner = DragLearner()
        taught(learner, range(120), np.random.default_rng(seed))
        found = told(learner, 130, 0.8)
        off = np.array(found.v_ne_mps) - 10.0 * np.array([np.cos(0.8), np.sin(0.8)])
        assert np.hypot(*off) < 1.5
        squares.append(off @ np.linalg.solve(found.error_m2ps2 + found.noise_m2ps2, off))
    assert float(np.mean(squares)) < 2.0
    assert float(np.max(squares)) < 12.0


@pytest.mark.parametrize("k1", [0.12, 0.5, 1.0])
def test_light_and_heavy_vehicles_are_learned(k1: float) -> None:
    state = TRUE.copy()
    state[:2] = k1, 0.0
    learner = DragLearner()
    taught(learner, range(120), np.random.default_rng(3), state)
    found = told(learner, 130, 1.0, state=state)
    assert np.hypot(*(np.array(found.v_ne_mps) - 10.0 * np.array([np.cos(1.0), np.sin(1.0)]))) < 1.5


def test_says_nothing_before_it_has_learned() -> None:
    learner = DragLearner()
    assert learner.velocity(*second(0, 0.0, 10.0)) is None
    taught(learner, range(ENOUGH - 1), np.random.default_rng(1))
    assert learner.velocity(*second(ENOUGH, 0.0, 10.0)) is None


def test_a_plane_has_no_drag_that_tells_its_velocity() -> None:
    """Its thrust takes up what the air takes, at every speed."""
    learner, rng = DragLearner(), np.random.default_rng(2)
    for t in range(300):
        felt, v = second(t, HEADINGS[t // 30 % 4], 20.0 + 3.0 * np.sin(t / 7))
        learner.learn(Felt(felt.t_boot_ns, 0.2 * rng.standard_normal(2), felt.axes_ned), v, EXACT)
        assert not learner.known or t < CHOSEN_AFTER
    assert learner.velocity(*second(300, 0.0, 20.0)) is None


@pytest.mark.parametrize("noise_mps2", [2.0, 3.0, 10.0])
def test_a_force_that_scatters_far_more_than_the_drag_tells_nothing(noise_mps2: float) -> None:
    """A plane's: what its wings do in turns once passed for a drag, and its pitot tube was not asked."""
    learner, rng = DragLearner(), np.random.default_rng(2)
    for t in range(150):
        learner.learn(*second(t, HEADINGS[t // 15 % 4], 14.0, noise=noise_mps2 * rng.standard_normal(2)), EXACT)
        assert not learner.known
    assert learner.velocity(*second(150, 0.0, 14.0)) is None


def test_another_course_is_doubted_more() -> None:
    learner = DragLearner()
    taught(learner, range(70), np.random.default_rng(4))
    assert told(learner, 100, 0.3).doubt_m2ps2 is None
    same, other = told(learner, 101, 0.3).doubt_m2ps2, told(learner, 102, 2.8).doubt_m2ps2
    assert same is not None and other is not None
    assert np.trace(other) > 5 * np.trace(same)
    learner.filter_restarted()
    assert told(learner, 103, 2.8).doubt_m2ps2 is None


def test_a_velocity_that_is_poorly_known_teaches_less() -> None:
    well, poorly, rng = DragLearner(), DragLearner(), np.random.default_rng(5)
    for t in range(90):
        felt, v = second(t, HEADINGS[t // 15 % 4], min(10.0, 2.0 * (t % 15)), noise=0.1 * rng.standard_normal(2))
        well.learn(felt, v, EXACT)
        poorly.learn(felt, v, np.eye(2))
    assert np.trace(told(poorly, 100, 1.0).error_m2ps2) > 1.5 * np.trace(told(well, 100, 1.0).error_m2ps2)


def test_a_dropped_payload_makes_another_vehicle_of_it() -> None:
    learner, lighter = DragLearner(), np.array([0.9, 0.08, 3.0, -4.0, 0.05, -0.05])
    taught(learner, range(90), np.random.default_rng(6))
    for t in range(90, 90 + GATED_IN_A_ROW):
        assert learner.known
        learner.learn(*second(t, 1.6, 10.0, lighter), EXACT)
    assert not learner.known
    taught(learner, range(120, 240), np.random.default_rng(7), lighter)
    assert np.hypot(*(np.array(told(learner, 250, 0.0, state=lighter).v_ne_mps) - (10.0, 0.0))) < 1.0


def test_a_second_beyond_the_gate_makes_a_hypothesis_less_likely() -> None:
    one, rng = _Hypothesis(0.2), np.random.default_rng(8)
    for t in range(40):
        one.learn(*second(t, HEADINGS[t // 10 % 4], 8.0, noise=0.1 * rng.standard_normal(2)), EXACT)
    before = one.log_likelihood
    one.learn(*second(41, 0.0, 8.0, noise=np.array([9.0, -9.0])), EXACT)
    assert one.gated == 1
    assert one.log_likelihood < before - 5


def test_a_vehicle_on_its_side_tells_no_velocity_over_the_ground() -> None:
    """Neither of its axes' forces is one along the ground: the drag is known, the velocity is not."""
    learner = DragLearner()
    taught(learner, range(120), np.random.default_rng(3))
    assert learner.known
    felt, v = second(130, 0.0, 10.0)
    steep = np.asarray(se3.R_from_quat(se3.quat_from_euler(0.0, -1.45, 0.0))[:, :2].T)
    assert learner.velocity(Felt(felt.t_boot_ns, felt.force_mps2, steep), v) is None
    assert learner.velocity(felt, v) is not None


def test_a_turn_long_after_anything_was_learned_is_doubted_as_much_as_the_bias_wandered() -> None:
    squares = []
    for seed in range(20):
        rng, learner = np.random.default_rng(seed), DragLearner()
        taught(learner, range(120), rng)
        state = TRUE.copy()
        state[BIAS] += BIAS_WALK_MPS2_PER_SQRT_S * np.sqrt(150.0) * rng.standard_normal(2)
        ahead, back = told(learner, 269, 0.0, state=state), told(learner, 270, np.pi, state=state)
        assert back.doubt_m2ps2 is not None
        off = np.array(back.v_ne_mps) + 10.0 * np.eye(2)[0] - (np.array(ahead.v_ne_mps) - 10.0 * np.eye(2)[0])
        squares.append(off @ np.linalg.solve(back.doubt_m2ps2, off))
    assert 0.5 < float(np.mean(squares)) < 2.6, "of two"
