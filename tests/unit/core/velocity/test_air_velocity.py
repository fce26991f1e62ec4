from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core.filter import fusion
from visloc_companion.core.filter.belief import seeded
from visloc_companion.core.filter.propagation import AIR, HEADING, VELOCITY, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.core.velocity import air_velocity
from visloc_companion.core.velocity.air_velocity import AirError, AirVelocity
from visloc_companion.types import Accepted, FloatArray, Rejected

S = 1_000_000_000
SETTINGS = NavigatorSettings()
V = VELOCITY.start


def told(doubt: FloatArray | None, error: float = 0.5) -> AirVelocity:
    return AirVelocity(0, (10.0, 0.0), 0.09 * np.eye(2), error**2 * np.eye(2), doubt, (0.0, 10.0))


def coasting(aided: bool) -> fusion.Belief:
    """A minute of accelerations that err by 0.2 m/s² north, beside air that tells it 0.3 m/s off."""
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    for k in range(1, 61):
        belief = fusion.propagated(belief, k * S, (10.0 + 0.2 * (k - 0.5), 0.0), SETTINGS, (0.2, 0.0))
        if aided:
            doubt = None if k == 1 else 1e-4 * np.eye(2)
            belief, _ = air_velocity.observed(belief, AirError(k * S, (0.3 - 0.2 * k, 0.0), told(doubt)), SETTINGS)
    return belief


def test_what_the_air_tells_holds_an_inertial_velocity() -> None:
    aided, alone = coasting(aided=True), coasting(aided=False)
    assert abs(aided.x[0] - 600.0) < 40.0
    assert abs(aided.x[0] - 600.0) < 2.5 * math.sqrt(aided.P[0, 0])
    assert abs(alone.x[0] - 600.0) > 300.0
    assert aided.P[0, 0] < 0.1 * alone.P[0, 0]


def test_its_lasting_error_begins_with_what_it_claims() -> None:
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    assert belief.P[AIR.start, AIR.start] == pytest.approx(100.0)
    begun, outcome = air_velocity.observed(belief, AirError(0, (0.0, 0.0), told(None)), SETTINGS)
    assert isinstance(outcome, Accepted)
    assert math.sqrt(begun.P[6, 6]) < 0.5
    assert begun.P[V, V] < belief.P[V, V]
    assert begun.P[HEADING, HEADING] < belief.P[HEADING, HEADING]
    more, _ = air_velocity.observed(begun, AirError(0, (0.0, 0.0), told(np.eye(2))), SETTINGS)
    assert more.P[AIR, AIR][0, 0] > 1.3 * begun.P[AIR, AIR][0, 0]


def test_a_gust_beyond_the_gate_is_not_taken() -> None:
    belief = fusion.with_inertial_velocity(seeded(0, (0.0, 0.0), 1.0, 0.3, Drive.AUTOPILOT, SETTINGS), 0.2)
    after, outcome = air_velocity.observed(belief, AirError(0, (30.0, 0.0), told(None)), SETTINGS)
    assert isinstance(outcome, Rejected)
    assert after.x[V] == belief.x[V]


@pytest.mark.parametrize("drive", [Drive.FED_BACK, Drive.AUTOPILOT, Drive.NONE])
def test_says_nothing_beside_another_velocity(drive: Drive) -> None:
    belief = seeded(0, (0.0, 0.0), 1.0, 0.3, drive, SETTINGS)
    same, _ = air_velocity.observed(belief, AirError(0, (3.0, 0.0), told(None)), SETTINGS)
    assert same is belief


def test_holds_where_it_is_known_well() -> None:
    assert told(None, error=1.0).holds
    assert not told(None, error=2.0).holds


def test_gusts_that_last_are_doubted_by_what_a_second_scatters() -> None:
    """Two samples a second have twice the noise of one each."""
    before, at_first = told(np.zeros((2, 2))), told(None)
    assert air_velocity.gusty(at_first, 1.0) is at_first
    second, two, half = (air_velocity.gusty(before, s).doubt_m2ps2 for s in (1.0, 2.0, 0.5))
    assert second is not None and two is not None and half is not None
    assert 0.2 * before.noise_m2ps2[0, 0] < second[0, 0] < before.noise_m2ps2[0, 0]
    assert two == pytest.approx(2 * second)
    assert 2 * half == pytest.approx(second / 2)
