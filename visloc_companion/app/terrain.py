"""From the section `localiser` of the configuration to who answers about the ground below the track."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from visloc_companion.config import LocaliserConfig
from visloc_companion.protocols import ReferenceMap
from visloc_companion.types import Fix, NoFix, TerrainRequest

TerrainAnswer = Callable[[TerrainRequest], Fix | NoFix]


def configured_terrain(chosen: LocaliserConfig, reference: ReferenceMap) -> TerrainAnswer:
    """The function that matches profiles of the ground with the surface of a map. What it needs of SciPy is imported now where
    it will be asked, else with the first question: it would hold up the start."""
    if chosen.terrain:
        import_module("visloc_companion.localise.terrain.answer")

    def answer(request: TerrainRequest) -> Fix | NoFix:
        from visloc_companion.localise.terrain.answer import answer_terrain

        return answer_terrain(
            request, reference, chosen.terrain_sigma_m, chosen.max_probability_wrong, chosen.max_search_radius_m
        )

    return answer
