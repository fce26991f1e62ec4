"""Positions that leap away and are back in the next record: in a log without checksums, a flipped bit.

Vehicles do not move so; false positions of a receiver do not either, they leap and stay. The autopilot's own position never comes
back within one record from far off, whatever its receivers say: such a record is left out, counted and told. Receivers may say
anything, and what they said is what a replay judges: theirs are told, and taken as they are.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from visloc_companion.adapters.logs.recording import NS_PER_S, Losses
from visloc_companion.geo.wgs84 import distance_m
from visloc_companion.types import FIX_3D, Event, GeoPoint, Gnss, LocalPose, PriorPose, Vec3

LEAST_M, LEAST_MPS = 10_000.0, 1_000.0
"""A leap is at least so far, and so fast, both away and back."""
_AGREE = 0.1
"""The records before and after lie apart by less than this share of it."""
P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class LoneLeap:
    """Which event (by number), when, and how far at least from its neighbours."""

    number: int
    t_ns: int
    off_m: float


def lone_leaps(track: Sequence[tuple[int, int, P]], apart_m: Callable[[P, P], float]) -> list[LoneLeap]:
    """The leaps of a track of (number, t_ns, place) in time order."""
    found = []
    for (_, before_ns, before), (number, t_ns, place), (_, after_ns, after) in zip(track, track[1:], track[2:], strict=False):
        away_m = apart_m(before, place)
        if away_m < max(LEAST_M, LEAST_MPS * (t_ns - before_ns) / NS_PER_S):
            continue
        back_m = apart_m(place, after)
        off_m = min(away_m, back_m)
        if back_m >= max(LEAST_M, LEAST_MPS * (after_ns - t_ns) / NS_PER_S) and apart_m(before, after) < _AGREE * off_m:
            found.append(LoneLeap(number, t_ns, off_m))
    return found


def without_lone_leaps(
    path: Path, events: list[tuple[int, Event]], losses: Losses
) -> tuple[list[tuple[int, Event]], tuple[str, ...]]:
    """The events of a log without checksums, in time order, but for the autopilot's positions that leap; sentences on these and
    on what a receiver's do."""
    numbered = [(number, t_ns, event) for number, (t_ns, event) in enumerate(events)]
    own = lone_leaps([(k, t_ns, e.place) for k, t_ns, e in numbered if isinstance(e, PriorPose)], distance_m)
    own += lone_leaps([(k, t_ns, e.p_ned_m) for k, t_ns, e in numbered if isinstance(e, LocalPose)], _level_m)
    fixes: defaultdict[int, list[tuple[int, int, GeoPoint]]] = defaultdict(list)
    for k, t_ns, event in numbered:
        if isinstance(event, Gnss) and event.fix_type >= FIX_3D:
            fixes[event.receiver].append((k, t_ns, event.place))
    received = [leap for of_one in fixes.values() for leap in lone_leaps(of_one, distance_m)]
    losses.leaping_positions += len(own)
    notes = [
        *_told(path, "positions of the autopilot", own, "left out as damaged, for the format has no checksums"),
        *_told(path, "positions of the receiver", received, "taken as they are"),
    ]
    if not own:
        return events, tuple(notes)
    damaged = {leap.number for leap in own}
    return [item for number, item in enumerate(events) if number not in damaged], tuple(notes)


def _told(path: Path, what: str, leaps: list[LoneLeap], done: str) -> list[str]:
    if not leaps:
        return []
    first = min(leaps, key=lambda leap: leap.t_ns)
    which = f"{len(leaps)}, the first at {first.t_ns / NS_PER_S:.3f} s of the boot clock, {first.off_m / 1000:.0f} km off"
    return [f"Of {path.name}, {what} that leap away for one record and back were {done}: {which}."]


def _level_m(a: Vec3, b: Vec3) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])
