"""A copter over hills, jammed after dusk: the ground below its track holds its position; without that it drifts and must land."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.terrain_loop import errors_m, fly, settings_for, terrain_fixes
from visloc_companion.app.replay import command_lines, recorded_commands, replay_entries
from visloc_companion.sim.flight import FlightLog
from visloc_companion.types import TerrainRequest

SECONDS = 160.0


@pytest.fixture(scope="module")
def by_terrain() -> FlightLog:
    return fly("copter", SECONDS, terrain=True)


def test_terrain_holds_the_position_and_without_it_the_position_drifts_until_the_copter_lands(by_terrain: FlightLog) -> None:
    alone = fly("copter", SECONDS, terrain=False)
    held, drifting = errors_m(by_terrain), errors_m(alone)
    assert held.max() < 80
    assert np.median(held) < 40
    assert by_terrain.failsafe is None
    assert drifting[-1] > 1.5 * held.max()
    assert alone.failsafe is not None


def test_the_fixes_are_near_the_truth_and_say_how_near(by_terrain: FlightLog) -> None:
    fixes = terrain_fixes(by_terrain)
    assert len(fixes) >= 2
    for fix, off_m in fixes:
        assert off_m < 20
        assert off_m**2 < 9.2 * (fix.cov_ne_m2[0][0] + fix.cov_ne_m2[1][1])


def test_a_replay_of_the_journal_asks_and_says_the_same(by_terrain: FlightLog) -> None:
    recorded = list(command_lines(recorded_commands(by_terrain.entries)))
    assert any(isinstance(entry.command, TerrainRequest) for entry in by_terrain.entries)
    assert list(command_lines(replay_entries(by_terrain.entries, settings_for(terrain=True)))) == recorded
