"""What is worked out of a map's light, place by place."""

from __future__ import annotations

from dataclasses import dataclass, field

from visloc_companion.localise.mapped.map_suns import MapSuns
from visloc_companion.localise.mapped.relit_tiles import RelitTiles


@dataclass(frozen=True, slots=True, eq=False)
class MapLight:
    """The suns over a map's picture, and its tiles under others. It is the map's alone: localisers for other lenses may share it,
    one after the other."""

    suns: MapSuns = field(default_factory=MapSuns)
    relit: RelitTiles = field(default_factory=RelitTiles)
