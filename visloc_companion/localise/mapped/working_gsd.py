"""The resolution to work at: that of the map's stored features where there are any near the wanted one."""

from __future__ import annotations

from visloc_companion.localise.features.base import Features
from visloc_companion.protocols import FeatureMap, ReferenceMap


def working_gsd_m(ref: ReferenceMap, center_map_m: tuple[float, float], gsd_m: float, features: Features) -> float:
    """The map's stored GSD (metres on the ground, at a place in the map's CRS) nearest to a wanted one, else the wanted one.

    Only features of this name and recipe count, and only within a factor 2^0.25 of `gsd_m`. Asking again with the answer gives
    the answer again.
    """
    if not isinstance(ref, FeatureMap):
        return gsd_m
    stored = ref.stored_gsd_m(center_map_m, gsd_m, features.name, features.recipe)
    return gsd_m if stored is None else stored
