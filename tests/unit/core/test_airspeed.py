from __future__ import annotations

import math

import numpy as np
import pytest

from visloc_companion.core import airspeed, fusion
from visloc_companion.core.airspeed import Airspeed
from visloc_companion.core.belief import seeded
from visloc_companion.core.propagation import WIND, Drive
from visloc_companion.core.settings import NavigatorSettings
from visloc_companion.types import Accepted

S = 1_000_000_000
SETTINGS = NavigatorSettings()


def start(drive: Drive) -> fusion.Belief:
    return seeded(0, (0.0, 0.0), 1.0, 0.3, drive, SETTINGS)


def with_wind_known() -> fusion.Belief:
    """Over ground 20 m/s north through a wind of 5 m/s to the east, the velocity known from GNSS."""
    belief = start(Drive.AUTOPILOT)
    for k in range(1, 61):
        belief = fusion.propagated(belief, k * S, (20.0, 0.0), SETTINGS)
        belief, outcome = airspeed.observed(belief, Airspeed(k * S, (20.0, -5.0), 0.0), (20.0, 0.0), SETTINGS)
        assert isinstance(outcome, Accepted)
    return belief


def test_the_wind_is_learned_while_the_velocity_is_known() -> None:
    belief = with_wind_known()
    assert belief.x[WIND] == pytest.approx([0.0, 5.0], abs=0.3)
    assert math.sqrt(belief.P[6, 6]) < 0.6


def test_a_known_wind_holds_an_inertial_velocity_for_minutes() -> None:
    def coasting(aided: bool) -> fusion.Belief:
        belief = fusion.with_inertial_velocity(with_wind_known(), 0.1)
        for k in range(61, 181):
            belief = fusion.propagated(belief, k * S, (20.0 + 0.1 * (k - 60), 0.0), SETTINGS)
            if aided:
                z = Airspeed(k * S, (20.0, -5.0), 0.0)
                belief, _ = airspeed.observed(belief, z, (20.0 + 0.1 * (k - 60), 0.0), SETTINGS)
        return belief

    aided, alone = coasting(True), coasting(False)
    assert aided.x[2] == pytest.approx(12.0, abs=1.5)
    assert alone.x[2] == pytest.approx(0.0, abs=1.0)
    assert aided.P[0, 0] < 0.1 * alone.P[0, 0]


def test_a_turn_makes_another_wind_of_a_false_scale() -> None:
    known = with_wind_known()
    straight, _ = airspeed.observed(known, Airspeed(60 * S, (20.0, -5.0), 0.0), (20.0, 0.0), SETTINGS)
    turned, _ = airspeed.observed(known, Airspeed(60 * S, (20.0, -5.0), 30.0), (20.0, 0.0), SETTINGS)
    assert turned.P[6, 6] > 2 * straight.P[6, 6]


def test_says_nothing_beside_a_velocity_that_descends_from_our_own_fixes() -> None:
    belief = start(Drive.FED_BACK)
    same, _ = airspeed.observed(belief, Airspeed(0, (20.0, 0.0), 0.0), (0.0, 0.0), SETTINGS)
    assert same is belief


def test_true_airspeed_of_the_standard_atmosphere() -> None:
    density = 1.225
    assert airspeed.true_airspeed_mps(1013.25, density * 25**2 / 200) == pytest.approx(25.0, rel=1e-3)
    assert airspeed.true_airspeed_mps(898.76, 1.1117 * 25**2 / 200) == pytest.approx(25.0, rel=1e-3)
    assert airspeed.true_airspeed_mps(1013.25, -0.2) == 0.0
    assert airspeed.true_airspeed_mps(0.0, 1.0) == 0.0
    assert np.isfinite(airspeed.true_airspeed_mps(1.0, 1000.0))
