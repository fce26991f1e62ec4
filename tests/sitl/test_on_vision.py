"""The real daemon flies real autopilots in their own simulators: take-off with GNSS, jamming, minutes on vision, landing.

Fixes are the simulator's truth with stated noise; what is tested is autopilot, link, encoder and filter. Shorter than the flights
of docs/autopilots.md, with the same limits.
"""

from __future__ import annotations

import pytest

from visloc_companion.evaluate.real.real_flight import checks, real_figures
from visloc_companion.sim.real.programs import Simulator

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(900)]
TOUCH_DOWN_MPS = 1.5
COPTERS = [Simulator.ARDUCOPTER, Simulator.PX4]
FLYING = [*COPTERS, Simulator.ARDUPLANE]


@pytest.mark.parametrize("simulator", FLYING)
def test_minutes_on_vision_after_jamming(fly, simulator: Simulator) -> None:
    scenario, log = fly(simulator, "jam", duration_s=180.0, jam_at_s=30.0, lands=False)
    figures = real_figures(log, scenario)
    assert [check for check in checks(figures, scenario, simulator) if not check.passed] == []
    assert figures.vision_s > 120
    assert len(log.injected_s) > 1200


@pytest.mark.parametrize("simulator", FLYING)
def test_gnss_that_comes_back_is_flown_on_again(fly, simulator: Simulator) -> None:
    scenario, log = fly(simulator, "gnss_back", duration_s=140.0, jam_at_s=20.0, gnss_back_at_s=60.0)
    figures = real_figures(log, scenario)
    assert figures.failsafes == ()
    assert figures.wrong_source_s == 0
    assert log.samples[-1].phase == "gnss"
    assert figures.end_error_m is not None
    assert figures.end_error_m < 2.0


@pytest.mark.parametrize("simulator", [Simulator.ARDUCOPTER, Simulator.ARDUPLANE])
def test_a_slow_drag_is_left_in_time(fly, simulator: Simulator) -> None:
    scenario, log = fly(simulator, "slow_drag", duration_s=120.0, drag_at_s=30.0)
    figures = real_figures(log, scenario)
    assert [check for check in checks(figures, scenario, simulator) if not check.passed] == []


@pytest.mark.parametrize("simulator", COPTERS)
def test_without_the_daemon_the_same_flight_ends_in_a_failsafe(fly, simulator: Simulator) -> None:
    """Else the flights with it would show nothing."""
    scenario, log = fly(simulator, "without_daemon", duration_s=80.0, jam_at_s=20.0)
    assert real_figures(log, scenario).failsafes != ()


@pytest.mark.parametrize("simulator", COPTERS)
def test_a_copter_lands_on_vision_without_drifting(fly, simulator: Simulator) -> None:
    scenario, log = fly(simulator, "jam", duration_s=50.0, jam_at_s=20.0)
    touch_down_mps = real_figures(log, scenario).touch_down_mps
    assert touch_down_mps is not None
    assert touch_down_mps < TOUCH_DOWN_MPS
