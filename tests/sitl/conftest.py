"""What the tests against real simulators share: a program or a clear reason to skip, and a flight in a network of its own."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from visloc_companion.errors import ConfigError
from visloc_companion.sim.real.apart import fly_apart
from visloc_companion.sim.real.programs import Simulator, find_program
from visloc_companion.sim.real.record import RealLog
from visloc_companion.sim.real.scenario import RealScenario
from visloc_companion.sim.real.scenarios import real_scenario

SPEED = float(os.environ.get("VISLOC_SITL_SPEED", "3"))
Flight = tuple[RealScenario, RealLog]
Fly = Callable[..., Flight]


def program_or_skip(simulator: Simulator) -> Path:
    """The program of an autopilot; the test is skipped, with the package to install, where there is none."""
    try:
        return find_program(simulator)
    except ConfigError as why:
        pytest.skip(str(why))


@pytest.fixture
def fly(tmp_path: Path) -> Fly:
    """`fly(simulator, name, **changes)`: a flight of sim/real/scenarios.py, changed; skips where the program is missing."""

    def fly(simulator: Simulator, name: str, **changes: object) -> Flight:
        program_or_skip(simulator)
        scenario = replace(real_scenario(name, simulator), **changes)  # type: ignore[arg-type]
        return scenario, fly_apart(simulator, scenario, speed=SPEED, keep=tmp_path)

    return fly
