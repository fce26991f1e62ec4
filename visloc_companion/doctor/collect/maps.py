"""Opens the configured pack, whole, and holds it against home, mission and network."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from visloc_companion.app.ground_check import Ground, look
from visloc_companion.config import Config
from visloc_companion.doctor.facts import LinkFacts, MapFacts
from visloc_companion.errors import VislocError
from visloc_companion.geo.way import along
from visloc_companion.maps.manifest import manifest_bytes
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.registration import pack_tie
from visloc_companion.maps.signature import public_keys, require_signed
from visloc_companion.types import GeoPoint

_STEP_PX, _MOST_STEPS = 32, 2000
"""Of a leg of a mission: half a cell of `visloc map check`, and no more however long a wrong leg is."""


def read_map(config: Config, link: LinkFacts | None, network: tuple[str, str] | None) -> MapFacts | None:
    """The pack's state; None where none is configured. `network` are name and recipe of the features that are wanted."""
    if not config.map.pack:
        return None
    try:
        pack = PackMap.open(Path(config.map.pack), verify_hashes=config.map.verify_hashes)
    except VislocError as why:
        return MapFacts(problem=str(why))
    signed_by, signature_problem = _signature(config)
    manifest = pack.manifest
    home, mission = (link.home, link.mission) if link is not None else (None, None)
    return MapFacts(
        capture_date=manifest.capture_date,
        gsd_m=manifest.gsd_m,
        has_surface=manifest.heights.grid is not None,
        share_valid=manifest.share_valid,
        home_margin_m=None if home is None else margin_m(pack, [home]),
        mission_margin_m=margin_m(pack, mission) if mission else None,
        home_empty=home is not None and empty_share(pack, [home]) > 0.0,
        mission_empty=empty_share(pack, mission) if mission else 0.0,
        height_above_surface_m=None if home is None else _above_surface(pack, home),
        features_missing="" if network is None else pack.why_not_stored(*network),
        crs_accuracy_m=pack_tie(pack).accuracy_m,
        signed_by=signed_by,
        signature_problem=signature_problem,
    )


def _signature(config: Config) -> tuple[str, str]:
    """Who of those that are trusted signed the pack, and why nobody did."""
    folder = Path(config.map.pack)
    try:
        trusted = public_keys(config.map.trusted_keys)
        return (require_signed(manifest_bytes(folder), folder, trusted) if trusted else ""), ""
    except VislocError as why:
        return "", str(why)


def margin_m(pack: PackMap, places: Iterable[GeoPoint]) -> float:
    """Distance of the place nearest to the map's edge from it, metres on the ground; negative outside."""
    return min(_margin_m(pack, place) for place in places)


def _margin_m(pack: PackMap, place: GeoPoint) -> float:
    try:
        easting, northing = pack.to_map(place.lat_deg, place.lon_deg)
        scale = pack.crs.linearised_at_map(easting, northing).scale
    except VislocError:
        return -math.inf
    box = pack.manifest.bounds
    edges = (easting - box.west_map_m, box.east_map_m - easting, northing - box.south_map_m, box.north_map_m - northing)
    return min(edges) / scale


def empty_share(pack: PackMap, places: Sequence[GeoPoint]) -> float:
    """Share of a way, from place to place, over ground of which the pack shows nothing: beside it, empty corners, holes."""
    way = along(places, _STEP_PX * pack.gsd_m, _MOST_STEPS)
    return sum(not _shows(pack, place) for place in way) / len(way)


def _shows(pack: PackMap, place: GeoPoint) -> bool:
    try:
        patch = pack.patch(pack.to_map(place.lat_deg, place.lon_deg), (1, 1), pack.gsd_m, 0.0)
    except VislocError:
        return False
    return bool(patch.valid[0, 0])


def _above_surface(pack: PackMap, home: GeoPoint) -> float | None:
    found = look(Ground(pack, pack.manifest.heights.grid is not None), home, 0)
    return None if found.surface_amsl_m is None else home.h_amsl_m - found.surface_amsl_m
