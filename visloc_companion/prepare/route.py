"""Planned routes: CSV with lat_deg, lon_deg; MAVLink .waypoints (QGC WPL 110); QGroundControl .plan."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from visloc_companion.errors import MapError
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.types import GeoPoint

LAST_NAV_COMMAND = 95
"""MAV_CMD_NAV_LAST: commands up to here move the vehicle, those above only do something."""
WAYPOINT, RETURN_TO_LAUNCH, LAND, REGION_OF_INTEREST = 16, 20, 21, 80
LONGEST_LEG_M = 1_000_000.0
"""No map is as large (prepare/target.py); latitude and longitude that are exchanged make such legs."""
DO_JUMP = 177
_REMEDY = "give a CSV with the columns lat_deg,lon_deg, a .waypoints file (QGC WPL 110) or a QGroundControl .plan"


class Item(NamedTuple):
    """MAV_CMD, latitude, longitude (degrees), the number of the item, and that of the one to go on with after a jump."""

    command: int
    lat_deg: float
    lon_deg: float
    number: int = -1
    jump_to: int = -1

    @property
    def place(self) -> GeoPoint | None:
        """Where it leads; None where it leads nowhere."""
        leads = self.command <= LAST_NAV_COMMAND and self.command not in (RETURN_TO_LAUNCH, REGION_OF_INTEREST)
        return GeoPoint(self.lat_deg, self.lon_deg, 0.0) if leads and (self.lat_deg or self.lon_deg) else None


@dataclass(frozen=True, slots=True)
class Route:
    """The places of a route in order (heights are not used and are zero; of circles the middles), the rally points of a plan, to
    which an autopilot may return instead, and whether a return to launch is followed to the first place, for want of a home."""

    places: list[GeoPoint]
    rally: list[GeoPoint]
    lacks_home: bool = False


def read_route(path: Path) -> Route:
    """Read a file of any of the three kinds.

    Raises MapError for what is no route, with the line or the item that is wrong.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as why:
        raise MapError("there is no such file", where=str(path), remedy="name the file of a route") from why
    except (OSError, UnicodeDecodeError) as why:
        raise MapError(f"cannot be read: {why}", where=str(path), remedy=_REMEDY) from why
    try:
        if text.startswith("QGC WPL"):
            route = _waypoints(text)
        elif path.suffix.lower() == ".plan" or text.lstrip().startswith("{"):
            route = _plan(json.loads(text))
        else:
            route = Route(_table(text), [])
    except (csv.Error, ValueError, OverflowError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as why:
        raise MapError(f"is no route: {_told(why)}", where=str(path), remedy=_REMEDY) from why
    if not route.places:
        raise MapError("holds no place", where=str(path), remedy=_REMEDY)
    wrong = [p for p in (*route.places, *route.rally) if not (abs(p.lat_deg) <= 90 and abs(p.lon_deg) <= 180)]
    if wrong:
        raise MapError(f"{wrong[0].lat_deg}, {wrong[0].lon_deg} is no latitude, longitude", where=str(path), remedy=_REMEDY)
    _check_legs(route.places, path)
    return route


def _told(why: Exception) -> str:
    """What does not read as a route, in the words of its file."""
    if isinstance(why, (csv.Error, ValueError)):
        return str(why)
    laid_out = f"it is not laid out as QGroundControl does it ({type(why).__name__}: {why})"
    return f"{why} is missing" if isinstance(why, KeyError) else laid_out


def _check_legs(places: list[GeoPoint], path: Path) -> None:
    """Refuse a leg that no map holds: its points would be millions."""
    for start, end in pairwise(places):
        if (leg_m := distance_m(end, start)) > LONGEST_LEG_M:
            raise MapError(
                f"{end.lat_deg}, {end.lon_deg} lies {leg_m / 1000:.0f} km from {start.lat_deg}, {start.lon_deg} before it",
                where=str(path),
                remedy="correct the one that is wrong: the latitude comes first",
            )


def _table(text: str) -> list[GeoPoint]:
    rows = csv.DictReader(text.splitlines(), strict=True, skipinitialspace=True)
    rows.fieldnames = [name.strip() for name in rows.fieldnames or ()]
    missing = {"lat_deg", "lon_deg"} - set(rows.fieldnames)
    if missing:
        named = ", ".join(rows.fieldnames) or "nothing"
        commas = "; separate columns by commas, and write decimals with a point" if ";" in named or "\t" in named else ""
        raise ValueError(f"its first line names no column {' and '.join(sorted(missing))} ({named:.80}){commas}")
    if twice := [name for name in ("lat_deg", "lon_deg") if rows.fieldnames.count(name) > 1]:
        raise ValueError(f"its first line names {' and '.join(twice)} more than once")
    return [_place(row, rows.line_num) for row in rows]


def _place(row: dict[Any, Any], line: int) -> GeoPoint:
    if any(value.strip() for value in row.get(None, ())):
        raise ValueError(f"line {line}: has more values than the first line names columns; decimals have a point, no comma")
    return GeoPoint(_number(row["lat_deg"], line), _number(row["lon_deg"], line), 0.0)


def _number(text: str | None, line: int) -> float:
    try:
        return float(text or "")
    except ValueError as why:
        raise ValueError(f"line {line}: {text or 'nothing'!r} is no number of degrees") from why


def _waypoints(text: str) -> Route:
    lines = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1) if number > 1 and line.strip()]
    items = [_waypoint(row, number) for number, row in lines]
    home = GeoPoint(items[0][1], items[0][2], 0.0) if items and (items[0][1] or items[0][2]) else None
    return _flown(items[1:] if home else items, home, [])


def _waypoint(row: list[str], line: int) -> Item:
    try:
        command = int(row[3])
        jump_to = int(float(row[4])) if command == DO_JUMP else -1
        return Item(command, float(row[8]), float(row[9]), int(row[0]), jump_to)
    except (ValueError, IndexError) as why:
        raise ValueError(f"line {line}: is not twelve numbers, the 4th a command, the 9th and 10th latitude, longitude") from why


def _plan(plan: Any) -> Route:
    if "mission" not in plan:
        raise ValueError("it holds no mission")
    mission = plan["mission"]
    home = mission.get("plannedHomePosition")
    items = [item for n, entry in enumerate(mission["items"], 1) for item in _numbered(entry, n)]
    rally = [GeoPoint(float(at[0]), float(at[1]), 0.0) for at in (plan.get("rallyPoints") or {}).get("points") or ()]
    return _flown(items, GeoPoint(float(home[0]), float(home[1]), 0.0) if home and (home[0] or home[1]) else None, rally)


def _numbered(entry: Any, number: int) -> list[Item]:
    """The commands of an item; what is wrong with it is said with its number."""
    try:
        return _items(entry, number)
    except (ValueError, OverflowError, KeyError, IndexError, TypeError, AttributeError) as why:
        said = _told(why)
        raise ValueError(said if said.startswith("item ") else f"item {number}: {said}") from why


def _items(entry: Any, number: int) -> list[Item]:
    """The commands of an item of a plan; of a pattern that QGroundControl only flies, its places."""
    if entry["type"] == "SimpleItem":
        params = [0.0 if p is None else float(p) for p in entry["params"]]
        command = int(entry["command"])
        jump_to = int(params[0]) if command == DO_JUMP else -1
        return [Item(command, params[4], params[5], int(entry.get("doJumpId", -1)), jump_to)]
    inner = entry.get("TransectStyleComplexItem", entry).get("Items")
    if inner is not None:
        return [item for one in inner for item in _items(one, number)]
    if "landCoordinate" in entry:  # fwLandingPattern and vtolLandingPattern
        approach = entry["landingApproachCoordinate"] if "landingApproachCoordinate" in entry else entry["loiterCoordinate"]
        flown = (WAYPOINT, approach), (LAND, entry["landCoordinate"])
        return [Item(command, float(at[0]), float(at[1])) for command, at in flown]
    kind = entry.get("complexItemType", "of an unknown kind")
    raise ValueError(
        f"item {number} ({kind}) does not say where it flies: send the plan to the vehicle, download it from there and save that"
    )


def _flown(items: list[Item], home: GeoPoint | None, rally: list[GeoPoint]) -> Route:
    """The places in order; a jump is followed once, there and back, for what comes after it is flown from where it began."""
    places, lacks_home = [home] if home else [], False
    for item in items:
        if item.command == RETURN_TO_LAUNCH and places:
            places.append(home or places[0])
            lacks_home = home is None
        elif item.command == DO_JUMP and places and (there := _place_from(items, item.jump_to)):
            places += [there, places[-1]]
        elif place := item.place:
            places.append(place)
    return Route(places, rally, lacks_home)


def _place_from(items: list[Item], number: int) -> GeoPoint | None:
    """Where the item of a number leads to, or the first after it that leads anywhere."""
    start = next((k for k, item in enumerate(items) if item.number == number), len(items))
    return next((place for item in items[start:] if (place := item.place)), None)
