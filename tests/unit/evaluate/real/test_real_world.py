"""The world below a flight with rendered frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.evaluate.real import real_world
from visloc_companion.evaluate.real.real_world import over_its_world
from visloc_companion.prepare.world import ProceduralWorld, procedural_world
from visloc_companion.sim.real.pilot import HOME
from visloc_companion.sim.real.programs import Simulator
from visloc_companion.sim.real.scenarios import real_scenario


def test_other_flights_stay_where_they_are() -> None:
    scenario = real_scenario("jam", Simulator.PX4)
    assert over_its_world(scenario) is scenario


def test_rendered_frames_are_of_the_world_about_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def small(seed: int) -> ProceduralWorld:
        return procedural_world(seed, tmp_path, size_m=200.0, networks=[])

    monkeypatch.setattr(real_world, "procedural_world", small)
    scenario = over_its_world(real_scenario("rendered", Simulator.ARDUCOPTER))
    assert scenario.seen is not None
    assert scenario.seen.pack.is_dir()
    assert scenario.seen.ortho != scenario.seen.pack
    assert scenario.home != HOME
    assert 0 < scenario.home.h_amsl_m < 3000
