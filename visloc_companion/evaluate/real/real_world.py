"""The procedural world below a flight against a real simulator: what the camera sees is years younger than the map."""

from __future__ import annotations

from dataclasses import replace

from visloc_companion.evaluate.closed_loop import FlightWorld
from visloc_companion.maps.pack import PackMap
from visloc_companion.prepare.world import procedural_world
from visloc_companion.sim.real.scenario import RealScenario, SeenWorld
from visloc_companion.sim.real.scenarios import SEEN
from visloc_companion.sim.scene import Scene

WORLD_SEED = 1


def over_its_world(scenario: RealScenario) -> RealScenario:
    """A flight with rendered frames over the middle of the procedural world; any other as it is. Raises MapError."""
    if scenario.name not in SEEN:
        return scenario
    world = procedural_world(WORLD_SEED)
    reference, scene = PackMap.open(world.pack, verify_hashes=False), Scene.load(world.flight_ortho, world.flight_dsm)
    home = FlightWorld(world.pack, reference, scene).area().home
    return replace(scenario, home=home, seen=SeenWorld(world.pack, world.flight_ortho, world.flight_dsm))
