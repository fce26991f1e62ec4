"""Whether the places of a flight can be true at all: on which side of the earth its truth and its log lie of the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from visloc_companion.adapters.logs.recording import Recording
from visloc_companion.adapters.logs.truth import TruthRow
from visloc_companion.errors import LogError
from visloc_companion.maps.pack import PackMap
from visloc_companion.types import FIX_3D, Event, FloatArray, GeoPoint, Gnss, PriorPose

FAR_M = 100_000.0
"""No vehicle of a map is so far from all of it."""
SWAPPED_M = 10_000.0
"""Places further off than this, that lie nearer with latitude and longitude exchanged, were exchanged: by chance no wrong place
does. Spoofing may pull a receiver as far, but not onto the mirror image of the map."""
_INNER = (0.05, 0.95)
_EARTH_M = 6_371_000.0


@dataclass(frozen=True, slots=True)
class Area:
    """A geographic box, degrees; `west_deg` > `east_deg` where it crosses 180°. `name` is what an error calls it."""

    name: str
    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float


def check_places(recording: Recording, truth: Sequence[TruthRow], truth_file: Path, reference: PackMap | None) -> list[str]:
    """Sentences on what of a flight lies far from the map, or without one from where the log says that it was.

    A log may lie far off: its GNSS may have been false all the time. Raises LogError for a truth that is elsewhere than the map,
    and for places whose latitude and longitude are exchanged.
    """
    flown, told = flown_places(recording.events), lat_lon_deg_of([row.place for row in truth])
    if reference is not None:
        box = reference.manifest.bounds
        of_map = Area("the map", box.south_deg, box.west_deg, box.north_deg, box.east_deg)
        flown_off_m = distance_right_way_round_m(recording.path, flown, of_map)
        refuse_far_off(truth_file, distance_right_way_round_m(truth_file, told, of_map), of_map)
        return far_off_noted("All positions of the log", flown_off_m, of_map)
    of_log = area_about("the log's positions", flown)
    if of_log is None:
        return []
    return far_off_noted("All places of the truth", distance_right_way_round_m(truth_file, told, of_log), of_log)


def area_about(name: str, lat_lon_deg: FloatArray) -> Area | None:
    """The box about (N, 2) latitudes and longitudes but for the outermost, which may be false; None without any."""
    if not len(lat_lon_deg):
        return None
    first_deg = lat_lon_deg[0, 1]
    south_deg, north_deg = np.quantile(lat_lon_deg[:, 0], _INNER)
    edges_deg = first_deg + np.quantile(_wrapped_deg(lat_lon_deg[:, 1] - first_deg), _INNER)
    west_deg, east_deg = (float(edge) for edge in _wrapped_deg(edges_deg))
    return Area(name, float(south_deg), west_deg, float(north_deg), east_deg)


def least_distance_m(area: Area, lat_lon_deg: FloatArray) -> float:
    """How far the nearest of (N, 2) places lies from a box, metres to 1 %; 0 where one is in it, inf without any on earth."""
    on_earth = lat_lon_deg[np.abs(lat_lon_deg[:, 0]) <= 90]  # what is exchanged may not be
    if not len(on_earth):
        return np.inf
    lat = np.radians(on_earth[:, 0])
    half_deg = ((area.east_deg - area.west_deg) % 360) / 2
    offset = _wrapped_deg(on_earth[:, 1] - (area.west_deg + half_deg))
    beside = np.radians(offset - np.clip(offset, -half_deg, half_deg))
    nearest = np.clip(lat, np.radians(area.south_deg), np.radians(area.north_deg))
    chord = np.sin((lat - nearest) / 2) ** 2 + np.cos(lat) * np.cos(nearest) * np.sin(beside / 2) ** 2
    return float(2 * _EARTH_M * np.arcsin(np.sqrt(np.min(chord))))


def flown_places(events: Sequence[tuple[int, Event]]) -> FloatArray:
    """(N, 2) latitudes and longitudes, degrees, of the autopilot's positions and of the receivers' with a fix; none at 0, 0,
    which is what both say before they know."""
    known = (
        event for _, event in events if isinstance(event, PriorPose) or (isinstance(event, Gnss) and event.fix_type >= FIX_3D)
    )
    places = lat_lon_deg_of([event.place for event in known])
    return np.asarray(places[np.abs(places).max(axis=1) > 1e-3])


def lat_lon_deg_of(places: Sequence[GeoPoint]) -> FloatArray:
    """(N, 2) latitudes and longitudes, degrees."""
    return np.array([(place.lat_deg, place.lon_deg) for place in places], dtype=np.float64).reshape(-1, 2)


def distance_right_way_round_m(where: Path, places: FloatArray, area: Area) -> float:
    """`least_distance_m`. Raises LogError where places (N, 2) lie far off, and nearby with latitude and longitude exchanged."""
    off_m = least_distance_m(area, places)
    if not SWAPPED_M < off_m < np.inf:
        return off_m
    exchanged_m = least_distance_m(area, places[:, ::-1])
    if exchanged_m <= SWAPPED_M:
        raise LogError(
            f"latitude and longitude are exchanged: its places lie {off_m / 1000:.0f} km from {area.name}, "
            f"the other way round {exchanged_m / 1000:.0f} km",
            where=str(where),
            remedy="write them in their own columns",
        )
    return off_m


def refuse_far_off(where: Path, off_m: float, area: Area) -> None:
    """Raises LogError where the nearest of a file's places lies far off."""
    if FAR_M < off_m < np.inf:
        raise LogError(
            f"none of its places lies near {area.name}: the nearest is {off_m / 1000:.0f} km off",
            where=str(where),
            remedy="check signs (south and west are negative) and degrees, and that it is of this flight and the map is",
        )


def far_off_noted(what: str, off_m: float, area: Area) -> list[str]:
    """A sentence where the nearest of some places lies far off."""
    if FAR_M < off_m < np.inf:
        return [f"{what} lie {off_m / 1000:.0f} km and more from {area.name}: are they of one flight?"]
    return []


def _wrapped_deg(angle_deg: FloatArray) -> FloatArray:
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)
