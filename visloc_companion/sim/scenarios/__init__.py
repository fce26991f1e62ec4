"""The library of flights: what goes wrong, when, and what must come out. Times are seconds since the start of the flight."""

from __future__ import annotations

from visloc_companion.sim.scenarios.base import Course, Expectation, Scenario
from visloc_companion.sim.scenarios.camera import CAMERA
from visloc_companion.sim.scenarios.gimbal import GIMBAL
from visloc_companion.sim.scenarios.onboard import ONBOARD
from visloc_companion.sim.scenarios.satellites import DEMO, LONG_JAM, SATELLITES
from visloc_companion.sim.scenarios.world import SEASON_CHANGE, WORLD

__all__ = ["DEMO", "FLIGHTS", "SCENARIOS", "SEASON_CHANGE", "Course", "Expectation", "Scenario"]

SCENARIOS: dict[str, Scenario] = {**SATELLITES, **WORLD, **CAMERA, **GIMBAL, **ONBOARD}
"""The library: campaigns fly all of it."""

FLIGHTS: dict[str, Scenario] = {**SCENARIOS, DEMO.name: DEMO, LONG_JAM.name: LONG_JAM}
"""All by name. The last two, the demonstration and a long flight, are no part of campaigns."""
