from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core import drag_aiding, fusion
from visloc_companion.core.belief import seeded
from visloc_companion.core.drag_aiding import DragError, Forces, Second, holds
from visloc_companion.core.drag_velocity import DragVelocity
from visloc_companion.core.propagation import HEADING, WIND, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.geo.se3 import quat_from_euler
from visloc_companion.types import Accepted, FloatArray, Quat, Rejected

S, STEP_NS = 1_000_000_000, 20_000_000
SETTINGS = NavigatorSettings()
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


def told(doubt: FloatArray | None, error: float = 0.5) -> DragVelocity:
    return DragVelocity(0, (10.0, 0.0), 0.09 * np.eye(2), error**2 * np.eye(2), doubt, (0.0, 10.0))


def coasting(aided: bool) -> fusion.Belief:
    """A minute of accelerations that err by 0.2 m/s² north, beside a drag that is 0.3 m/s off."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    for k in range(1, 61):
        belief = fusion.propagated(belief, k * S, (10.0 + 0.2 * (k - 0.5), 0.0), SETTINGS, (0.2, 0.0))
        if aided:
            doubt = None if k == 1 else 1e-4 * np.eye(2)
            belief, _ = drag_aiding.observed(belief, DragError(k * S, (0.3 - 0.2 * k, 0.0), told(doubt)), SETTINGS)
    return belief


def test_a_known_drag_holds_an_inertial_velocity() -> None:
    aided, alone = coasting(aided=True), coasting(aided=False)
    assert abs(aided.x[0] - 600.0) < 40.0
    assert abs(aided.x[0] - 600.0) < 2.5 * math.sqrt(aided.P[0, 0])
    assert abs(alone.x[0] - 600.0) > 300.0
    assert aided.P[0, 0] < 0.1 * alone.P[0, 0]


def test_its_lasting_error_begins_with_what_drag_claims() -> None:
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    assert belief.P[6, 6] == pytest.approx(100.0)
    begun, outcome = drag_aiding.observed(belief, DragError(0, (0.0, 0.0), told(None)), SETTINGS)
    assert isinstance(outcome, Accepted)
    assert math.sqrt(begun.P[6, 6]) < 0.5
    assert begun.P[2, 2] < belief.P[2, 2]
    assert begun.P[HEADING, HEADING] < belief.P[HEADING, HEADING]
    more, _ = drag_aiding.observed(begun, DragError(0, (0.0, 0.0), told(np.eye(2))), SETTINGS)
    assert more.P[WIND, WIND][0, 0] > 1.3 * begun.P[WIND, WIND][0, 0]


def test_a_gust_beyond_the_gate_is_not_taken() -> None:
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    after, outcome = drag_aiding.observed(belief, DragError(0, (30.0, 0.0), told(None)), SETTINGS)
    assert isinstance(outcome, Rejected)
    assert after.x[2] == belief.x[2]


@pytest.mark.parametrize("drive", [Drive.FED_BACK, Drive.AUTOPILOT, Drive.NONE])
def test_says_nothing_beside_another_velocity(drive: Drive) -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.3, drive, SETTINGS)
    same, _ = drag_aiding.observed(belief, DragError(0, (3.0, 0.0), told(None)), SETTINGS)
    assert same is belief


def test_holds_where_it_is_known_well() -> None:
    assert holds(told(None, error=1.0))
    assert not holds(told(None, error=2.0))
