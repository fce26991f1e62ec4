from __future__ import annotations

import math

import pytest

from visloc_companion.core.velocity.forces import Forces, Second
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Quat

S, STEP_NS = 1_000_000_000, 20_000_000
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


def seconds(forces: Forces, from_ns: int, n: int, turn_radps: float = 0.0, *, alone: bool = False) -> list[Second]:
    """50 forces a second, 10 velocities."""
    complete = []
    for k in range(n):
        if k % 5 == 0:
            forces.on_velocity((8.0, 1.0 + (k // 5) % 2, -0.5), alone=alone)
        q = quat_from_euler(0.1, -0.2, turn_radps * k * STEP_NS * 1e-9)
        second = forces.on_force(from_ns + k * STEP_NS, (-2.0 + (k % 2), 0.5, -9.8), q)
        if second is not None:
            complete.append(second)
    return complete


def test_a_second_is_the_mean_of_its_forces_and_velocities() -> None:
    first, *_ = seconds(Forces(), 5 * S, 120)
    assert first.felt.force_mps2 == pytest.approx([-1.51, 0.5], abs=0.01)
    assert first.felt.t_boot_ns == 5 * S + S // 2
    assert first.v_ned_mps == pytest.approx((8.0, 1.5, -0.5), abs=0.1)
    assert first.felt.axes_ned.shape == (2, 3)
    assert not first.alone


def test_one_velocity_without_gnss_makes_a_second_of_its_own_kind() -> None:
    assert all(second.alone for second in seconds(Forces(), 0, 120, alone=True))


def test_a_second_that_turns_has_no_axis() -> None:
    assert seconds(Forces(), 0, 200, turn_radps=math.radians(30)) == []
    assert len(seconds(Forces(), 0, 200, turn_radps=math.radians(10))) == 3


def test_a_gap_begins_another_second_and_a_repeated_force_is_dropped() -> None:
    forces = Forces()
    assert seconds(forces, 0, 45) == []
    assert seconds(forces, 2 * S, 45) == []
    assert forces.on_force(2 * S, (99.0, 99.0, 0.0), LEVEL) is None
    (second,) = seconds(forces, 2 * S + 45 * STEP_NS, 6)
    assert second.felt.force_mps2 == pytest.approx([-1.5, 0.5], abs=0.02)


def test_without_any_velocity_a_second_says_nothing() -> None:
    forces = Forces()
    assert all(forces.on_force(k * STEP_NS, (0.0, 0.0, -9.8), LEVEL) is None for k in range(200))
