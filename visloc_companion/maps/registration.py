"""How well the CRS of a map is tied to WGS 84, in which the autopilot knows places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from visloc_companion.maps.geotiff import crs_of
from visloc_companion.maps.pack import PackMap

GOOD_M = 1.0
"""What EPSG states of ETRS89 and its like, which are held for WGS 84: nothing to warn of."""


class Tie(NamedTuple):
    """What is stated of the relation of a CRS of this name to WGS 84, metres; None where nothing is."""

    name: str
    accuracy_m: float | None


def pack_tie(pack: PackMap) -> Tie:
    """The loosest of a pack: of its CRS in its middle, and of those that its orthophotos were changed from."""
    box = pack.manifest.bounds
    own_m = pack.crs.accuracy_m((box.west_map_m + box.east_map_m) / 2, (box.south_map_m + box.north_map_m) / 2)
    ties = [Tie(pack.crs.name, own_m), *(Tie(each.name, each.accuracy_m) for each in pack.manifest.reprojected_from)]
    return max(ties, key=lambda tie: math.inf if tie.accuracy_m is None else tie.accuracy_m)


def why_off(tie: Tie) -> str:
    """A warning where all fixes on a map that hangs on this may be off by more than GOOD_M; else empty."""
    name, accuracy_m = tie
    if accuracy_m is not None and accuracy_m <= GOOD_M:
        return ""
    known = "nobody states how well" if accuracy_m is None else f"to about {accuracy_m:g} m"
    return (
        f"{name} is tied to WGS 84 {known}, and every fix may be off by as much: compare the map with surveyed points, "
        "and state what is left as navigator.map_sigma_m"
    )


def registration_warnings(orthos: Sequence[Path]) -> list[str]:
    """One warning for each CRS of these orthophotos that may be off. Raises MapError, DatumMissing."""
    found: dict[str, float | None] = {}
    for path in orthos:
        crs, middle = crs_of(path)
        found.setdefault(crs.name, crs.accuracy_m(*middle))
    return [why for name, accuracy_m in found.items() if (why := why_off(Tie(name, accuracy_m)))]
