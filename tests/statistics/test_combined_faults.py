"""Several things go wrong at once, none of which the daemon is told of; the level bounds the error all the same."""

from __future__ import annotations

import math

import pytest

from benchmarks.combined_faults import Plan, flown
from benchmarks.flown.combined_faults_eyes import Spell
from visloc_companion.sim import faults
from visloc_companion.sim.setup import VehicleKind


@pytest.mark.parametrize(("vehicle", "error_deg"), [("copter", -30.0), ("plane", 50.0)])
def test_a_compass_that_pulls_the_heading_away_while_nothing_else_tells_it(vehicle: VehicleKind, error_deg: float) -> None:
    compass = faults.these(faults.CompassError(40.0, math.radians(error_deg), 4.0))
    worst = flown(Plan((), faults.jam(25.0) + compass, (), vehicle, duration_s=70.0), seed=8)
    assert worst.epochs > 200
    assert (worst.misleading, worst.hmi) == (0, 0)
    assert worst.ratio > 0.2
    assert worst.unsaid_s <= 2.0


def test_a_gnss_that_was_dragged_while_nothing_was_seen_and_is_then_jammed() -> None:
    drag = faults.these(faults.SlowDrag(30.0, (1.5, 0.0, 0.0), 75.0, 75.0), faults.Jam(75.0))
    worst = flown(Plan((), drag, (Spell("blind", 22.0, 85.0),), duration_s=92.0), seed=7)
    assert worst.at[0] > 75.0
    assert worst.epochs > 100
    assert (worst.misleading, worst.hmi) == (0, 0)
