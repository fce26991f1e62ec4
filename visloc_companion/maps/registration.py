"""How well the CRS of a map is tied to WGS 84, in which the autopilot knows places."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from visloc_companion.maps.geotiff import crs_of
from visloc_companion.maps.pack import PackMap

GOOD_M = 1.0
"""What EPSG states of ETRS89 and its like, which are held for WGS 84: nothing to warn of."""


def pack_accuracy_m(pack: PackMap) -> float | None:
    """What is stated of the relation of a pack's CRS to WGS 84 in its middle, metres; None where nothing is."""
    box = pack.manifest.bounds
    return pack.crs.accuracy_m((box.west_map_m + box.east_map_m) / 2, (box.south_map_m + box.north_map_m) / 2)


def why_off(name: str, accuracy_m: float | None) -> str:
    """A warning where all fixes on a map in the CRS of this name may be off by more than GOOD_M; else empty."""
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
    return [why for name, accuracy_m in found.items() if (why := why_off(name, accuracy_m))]
