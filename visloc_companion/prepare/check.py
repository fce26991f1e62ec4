"""What `visloc map check` says of a pack and a route."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from visloc_companion.core.validate import MAX_LATITUDE_DEG
from visloc_companion.errors import OutsideMap
from visloc_companion.geo.way import along
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.localise.features.base import Features
from visloc_companion.localise.features.gradient import GRADIENT
from visloc_companion.maps.manifest import Bounds, FeatureLevel, Manifest
from visloc_companion.maps.pack import PackMap
from visloc_companion.maps.registration import pack_tie, why_off
from visloc_companion.prepare.heights import cloud_above_at_places, cloud_above_surface_m, heights_warnings, surface_range
from visloc_companion.prepare.matchability import Matchability, matchability
from visloc_companion.prepare.route import Route, read_route
from visloc_companion.types import GeoPoint

MIN_SHARE_MATCHABLE = 0.5
WORTH_SAYING = 0.01
SPECKS = 0.01
"""Share of the ground about a place: black pixels of an image whose nodata is 0, a pond that was left out."""
_LOOKS = 65
"""Along each side of that ground: a map that ends 5 % further off may count as one that does not reach so far."""


def check_pack(pack: PackMap, route: Path | None, margin_m: float = 0.0, networks: Sequence[Features] = ()) -> dict[str, Any]:
    """Coverage, matchability and the route, as plain numbers; `passed` is False where the route leaves the map.

    `margin_m` is how far around the route the map must reach. `networks` are those that will fly: a warning says where the pack
    does not hold their features. Raises MapError for a file that is no route.
    """
    cells = matchability(pack)
    known = int(cells.known.sum())
    above = cloud_above_at_places(pack)
    tie = pack_tie(pack)
    result: dict[str, Any] = {
        "schema": 1,
        "name": pack.manifest.name,
        "files": len(pack.manifest.files),
        "share_valid": pack.manifest.share_valid,
        "share_with_height": pack.manifest.heights.share_known,
        "crs_accuracy_m": tie.accuracy_m,
        "surface": surface_range(pack),
        "cloud_above_surface_m": cloud_above_surface_m(above),
        "matchability": {
            "cell_m": cells.cell_m,
            "cells": known,
            "share_matchable": float(cells.good.sum()) / max(1, known),
            "share_flat": float(cells.flat.sum()) / max(1, known),
            "share_one_direction": float(cells.one_way.sum()) / max(1, known),
        },
    }
    planned = None if route is None else read_route(route)
    if planned is not None:
        result["route"] = _route(pack, cells, planned.places, margin_m)
    result["features"] = features_info(pack.manifest)
    result["cloud"] = cloud_info(pack.manifest)
    result["warnings"] = _warnings(result)
    result["warnings"] += [] if planned is None else _planned_warnings(pack, planned, margin_m)
    result["warnings"] += heights_warnings(above)
    result["warnings"] += [why] if (why := why_off(tie)) else []
    result["warnings"] += pole_warnings(pack.manifest.bounds)
    result["warnings"] += [why for each in (GRADIENT, *networks) if (why := pack.why_not_stored(each.name, each.recipe))]
    result["passed"] = planned is None or result["route"]["points_outside"] == 0
    return result


def _route(pack: PackMap, cells: Matchability, places: list[GeoPoint], margin_m: float) -> dict[str, Any]:
    points = along(places, cells.cell_m / 2)
    outside = [point for point in points if not on_map(pack, point, margin_m)]
    inside = np.array([on_map(pack, point, 0.0) for point in points])
    good = np.zeros(len(points), np.bool_)
    if inside.any():
        good[inside] = cells.at(np.array([pack.to_map(points[k].lat_deg, points[k].lon_deg) for k in np.flatnonzero(inside)]))
    first = outside[0] if outside else None
    return {
        "length_m": sum(distance_m(a, b) for a, b in pairwise(places)),
        "waypoints": len(places),
        "points": len(points),
        "points_outside": len(outside),
        "first_outside": None if first is None else {"lat_deg": first.lat_deg, "lon_deg": first.lon_deg},
        "share_matchable": float(good.mean()),
        "longest_unmatchable_m": longest_without_m(points, good),
    }


def longest_without_m(points: Sequence[GeoPoint], good: NDArray[np.bool_]) -> float:
    """Metres of the longest way from one of the points of a route that are good, or its start, to the next one, or its end."""
    along_m = np.cumsum([0.0, *(distance_m(a, b) for a, b in pairwise(points))])
    stops = [0, *np.flatnonzero(good).tolist(), len(points) - 1]
    return max((float(along_m[b] - along_m[a]) for a, b in pairwise(stops) if not good[a : b + 1].all()), default=0.0)


def on_map(pack: PackMap, place: GeoPoint, margin_m: float) -> bool:
    """Whether the map has content and height at a place, and reaches `margin_m` around it: of the square that is twice as wide no
    more than `SPECKS` may be missing."""
    if not pack.covers(place.lat_deg, place.lon_deg, -margin_m):
        return False
    looks = _LOOKS if margin_m else 1
    cell_m = max(pack.gsd_m, 2 * margin_m / _LOOKS)
    try:
        patch = pack.patch(pack.to_map(place.lat_deg, place.lon_deg), (looks, looks), cell_m, 0.0)
    except OutsideMap:
        return False
    middle, reach = looks // 2, min(looks // 2, round(margin_m / cell_m))
    square = slice(middle - reach, middle + reach + 1)
    return bool(patch.valid[middle, middle] and np.mean(patch.valid[square, square]) >= 1 - SPECKS)


def _warnings(result: dict[str, Any]) -> list[str]:
    found = []
    cells = result["matchability"]
    if cells["share_matchable"] < MIN_SHARE_MATCHABLE:
        found.append(f"only {cells['share_matchable']:.0%} of the map can be matched")
    if cells["share_flat"] >= WORTH_SAYING:
        found.append(f"{cells['share_flat']:.0%} of the map has little texture (water, snow, bare ground): fixes may fail there")
    if cells["share_one_direction"] >= WORTH_SAYING:
        found.append(f"{cells['share_one_direction']:.0%} of the map has edges of one direction only")
    if result["share_with_height"] <= 1 - WORTH_SAYING:
        found.append(f"{1 - result['share_with_height']:.0%} of the map has no height and is not used")
    if result["cloud"] is not None and result["cloud"]["share_covered"] <= 1 - WORTH_SAYING:
        found.append(f"{1 - result['cloud']['share_covered']:.0%} of the map has no point of the cloud")
    if "route" in result and result["route"]["points_outside"] == 0 and result["route"]["share_matchable"] < MIN_SHARE_MATCHABLE:
        found.append(f"only {result['route']['share_matchable']:.0%} of the route can be matched")
    return found


def pole_warnings(bounds: Bounds) -> list[str]:
    """A warning where a map reaches so near to a pole that no position is given there."""
    farthest_deg = max(abs(bounds.south_deg), abs(bounds.north_deg))
    if farthest_deg <= MAX_LATITUDE_DEG:
        return []
    return [
        f"it reaches {farthest_deg:.2f} degrees of latitude: beyond {MAX_LATITUDE_DEG:g} no position is given, and none taken"
    ]


def _planned_warnings(pack: PackMap, planned: Route, margin_m: float) -> list[str]:
    """What is to be said of the places that a route may lead to besides."""
    found = [
        f"the rally point {place.lat_deg:.6f}, {place.lon_deg:.6f} is off the map, and a return may lead there"
        for place in planned.rally
        if not on_map(pack, place, margin_m)
    ]
    if len(set(planned.places)) == 1:
        found.append("the route holds one place alone, as a mission that was saved empty does: no way was looked at")
    if planned.lacks_home:
        found.append("the route names no home: its return is followed to its first place, and the way from home is not looked at")
    return found


def pack_info(pack: PackMap, folder: Path) -> dict[str, Any]:
    """What `visloc map info` says: the manifest and the pack's size."""
    manifest = pack.manifest
    return {
        "schema": 1,
        "folder": str(folder),
        "bytes": sum(entry.bytes for entry in manifest.files.values()),
        "crs_accuracy_m": pack_tie(pack).accuracy_m,
        "surface": surface_range(pack),
        "features": features_info(manifest),
        "cloud": cloud_info(manifest),
        "manifest": manifest.model_dump(mode="json"),
    }


def features_info(manifest: Manifest) -> list[dict[str, Any]]:
    """For each function whose features are stored: GSDs, channels, recipe, bytes, and bytes for each square kilometre."""
    bounds = manifest.bounds
    area_km2 = (bounds.east_map_m - bounds.west_map_m) * (bounds.north_map_m - bounds.south_map_m) / 1e6
    names = dict.fromkeys(level.name for level in manifest.features)
    return [_function_info(manifest, [level for level in manifest.features if level.name == name], area_km2) for name in names]


def cloud_info(manifest: Manifest) -> dict[str, Any] | None:
    """Points of the pack's cloud, their density where there are any, the share of the map with points, and bytes."""
    cloud = manifest.cloud
    if cloud is None:
        return None
    bounds = manifest.bounds
    area_m2 = (bounds.east_map_m - bounds.west_map_m) * (bounds.north_map_m - bounds.south_map_m)
    return {
        "points": cloud.n_points,
        "points_per_m2": cloud.n_points / max(1e-9, area_m2 * cloud.share_covered),
        "share_covered": cloud.share_covered,
        "bytes": sum(manifest.files[name].bytes for name in (cloud.points, cloud.tiles)),
    }


def _function_info(manifest: Manifest, levels: list[FeatureLevel], area_km2: float) -> dict[str, Any]:
    size = sum(manifest.files[level.file].bytes for level in levels)
    return {
        "name": levels[0].name,
        "recipe": levels[0].recipe,
        "channels": levels[0].channels,
        "oriented": levels[0].oriented,
        "gsd_m": [level.gsd_m for level in levels],
        "n_dates": max(level.n_dates for level in levels),
        "bytes": size,
        "bytes_per_km2": size / max(area_km2, 1e-9),
    }
