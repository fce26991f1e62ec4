"""Planned routes: CSV with lat_deg, lon_deg; MAVLink .waypoints (QGC WPL 110); QGroundControl .plan."""

from __future__ import annotations

import csv
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

from visloc_companion.errors import MapError
from visloc_companion.geo.wgs84 import distance_m, geo_from_ned, ned_from_geo
from visloc_companion.types import GeoPoint

LAST_NAV_COMMAND = 95
"""MAV_CMD_NAV_LAST: commands up to here move the vehicle, those above only do something."""
RETURN_TO_LAUNCH = 20
_REMEDY = "give a CSV with the columns lat_deg,lon_deg, a .waypoints file (QGC WPL 110) or a QGroundControl .plan"


def read_route(path: Path) -> list[GeoPoint]:
    """The places of a route in order (heights are not used and are zero). Raises MapError for what is no route."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as why:
        raise MapError(f"cannot be read: {why}", where=str(path), remedy=_REMEDY) from why
    try:
        if path.suffix == ".plan":
            places = _plan(json.loads(text))
        elif text.startswith("QGC WPL"):
            places = _waypoints(text)
        else:
            places = _table(text)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as why:
        raise MapError(f"is no route: {type(why).__name__}: {why}", where=str(path), remedy=_REMEDY) from why
    if not places:
        raise MapError("holds no place", where=str(path), remedy=_REMEDY)
    wrong = [p for p in places if not (abs(p.lat_deg) <= 90 and abs(p.lon_deg) <= 180)]
    if wrong:
        raise MapError(f"{wrong[0].lat_deg}, {wrong[0].lon_deg} is no latitude, longitude", where=str(path), remedy=_REMEDY)
    return places


def along(places: list[GeoPoint], step_m: float) -> list[GeoPoint]:
    """The route's places and points between them, at most `step_m` apart."""
    points = places[:1]
    for start, end in pairwise(places):
        n = max(1, math.ceil(distance_m(end, start) / step_m))
        north, east, _ = ned_from_geo(end, start)
        points += [geo_from_ned((north * k / n, east * k / n, 0.0), start) for k in range(1, n)]
        points.append(end)
    return points


def _table(text: str) -> list[GeoPoint]:
    rows = csv.DictReader(text.splitlines(), strict=True)
    return [GeoPoint(float(row["lat_deg"]), float(row["lon_deg"]), 0.0) for row in rows]


def _waypoints(text: str) -> list[GeoPoint]:
    rows = [line.split() for line in text.splitlines()[1:] if line.strip()]
    items = [(int(row[3]), float(row[8]), float(row[9])) for row in rows]
    home = GeoPoint(items[0][1], items[0][2], 0.0) if items and (items[0][1] or items[0][2]) else None
    return _flown(items[1:] if home else items, home)


def _plan(plan: Any) -> list[GeoPoint]:
    mission = plan["mission"]
    home = mission.get("plannedHomePosition")
    items = [item for entry in mission["items"] for item in _simple_items(entry)]
    return _flown(items, GeoPoint(float(home[0]), float(home[1]), 0.0) if home else None)


def _simple_items(entry: Any) -> list[tuple[int, float, float]]:
    if entry["type"] == "SimpleItem":
        params = [0.0 if p is None else float(p) for p in entry["params"]]
        return [(int(entry["command"]), params[4], params[5])]
    inner = entry.get("TransectStyleComplexItem", entry)["Items"]
    return [item for one in inner for item in _simple_items(one)]


def _flown(items: list[tuple[int, float, float]], home: GeoPoint | None) -> list[GeoPoint]:
    places = [home] if home else []
    for command, lat_deg, lon_deg in items:
        if command == RETURN_TO_LAUNCH and home:
            places.append(home)
        elif command <= LAST_NAV_COMMAND and (lat_deg or lon_deg):
            places.append(GeoPoint(lat_deg, lon_deg, 0.0))
    return places
