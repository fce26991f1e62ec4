"""What a reader of logs gives back: events on one time base, and an honest account of what was lost on the way."""

from __future__ import annotations

import bisect
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

from visloc_companion.errors import LogError
from visloc_companion.geo.wgs84 import distance_m, geo_from_autopilot_ned
from visloc_companion.types import (
    FIX_3D,
    Attitude,
    AutopilotKind,
    Event,
    GeoPoint,
    Gnss,
    LinkChanged,
    LocalPose,
    OriginChanged,
    PriorPose,
)

LogBytes = bytes | mmap.mmap
NS_PER_US, NS_PER_MS, NS_PER_S = 1_000, 1_000_000, 1_000_000_000
MAX_FILE_BYTES = 4_000_000_000
BESIDE_NS = 2 * NS_PER_S
"""What a log states beside its messages (accuracies, dynamic pressure) counts for those so much later."""
FIRST_GPS_TYPE, SECOND_GPS_TYPE, BY_GPS_INPUT = ("GPS1_TYPE", "GPS_TYPE"), ("GPS2_TYPE", "GPS_TYPE2"), 14
"""ArduPilot's parameters, since 4.6 and before, and their value where a receiver is one that a companion plays by GPS_INPUT
(AP_GPS: MAV): visloc itself, say, with injection.output = "gps_input", which in flight does not listen to its own echo."""
FIRST_IS_PLAYED = (
    "WARNING: the first receiver is one that a companion plays by GPS_INPUT (GPS1_TYPE 14): if that was visloc, "
    "verdict and estimate rest on its own positions."
)
_PAIR_NS = 60 * NS_PER_MS
_MOVED_M = 20.0
"""An origin that is inferred scatters by metres; further off it is another one."""


@dataclass(slots=True)
class Losses:
    """What could not be used: pieces and bytes of garbage, messages without meaning, and jumps of the clocks; and what the
    autopilot says that it could not log in time (`dropouts`, and how long they lasted together)."""

    garbage_pieces: int = 0
    garbage_bytes: int = 0
    unknown_messages: int = 0
    dropped_messages: int = 0
    leaping_positions: int = 0
    foreign_messages: int = 0
    clock_steps: int = 0
    reboots: int = 0
    dropouts: int = 0
    dropouts_ms: int = 0
    truncated: bool = False

    def as_dict(self) -> dict[str, int]:
        """Names and counts, for results."""
        return {item.name: int(getattr(self, item.name)) for item in fields(self)}


@dataclass(slots=True)
class Recording:
    """Events of one autopilot in time order.

    `events` are (t_ns, event): `t_ns` is the arrival on the autopilot's boot clock (continued across a reboot), equal to the
    event's `t_rx_ns`. `unix_minus_boot_ns` places that clock on UTC where the log says so; with `utc_of_station` it is the ground
    station's clock, which may be wrong. `origin_inferred` tells that no GPS_GLOBAL_ORIGIN was in the log and `with_origin` made
    one up from the positions. `notes` are sentences on what else the reader chose.
    """

    path: Path
    kind: AutopilotKind
    events: list[tuple[int, Event]]
    losses: Losses
    unix_minus_boot_ns: int | None = None
    utc_of_station: bool = False
    origin_inferred: bool = False
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first to the last event, seconds."""
        return (self.events[-1][0] - self.events[0][0]) / NS_PER_S if self.events else 0.0


_NEEDED = {"attitude": Attitude, "satellite receiver": Gnss, "global position": PriorPose}


def lacking(events: list[tuple[int, Event]]) -> list[str]:
    """Names of what a navigator cannot do without and a log does not hold at all."""
    kinds = {type(event) for _, event in events}
    return [name for name, kind in _NEEDED.items() if kind not in kinds]


def read_bytes(path: Path) -> LogBytes:
    """The whole file, mapped: a log of 2 GB is read on a computer of 4 GB.

    Raises LogError for a file that is missing, unreadable, empty or larger than 4 GB.
    """
    try:
        with path.open("rb") as file:
            n_bytes = os.fstat(file.fileno()).st_size
            if n_bytes > MAX_FILE_BYTES:
                raise LogError("is larger than 4 GB", where=str(path), remedy="cut the log to the flight")
            if n_bytes == 0:
                raise LogError("is empty", where=str(path), remedy="use another recording")
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as why:
        raise LogError(f"cannot be read: {why}", where=str(path), remedy="name a readable log file") from why


def in_order(events: list[tuple[int, Event]]) -> list[tuple[int, Event]]:
    """The same events by time; those of equal time keep their order."""
    return sorted(events, key=lambda item: item[0])


def with_origin(recording: Recording) -> Recording:
    """The recording with an EKF origin, which the navigator needs and most ground stations never asked for.

    The origin is where the autopilot's local position and its global position of the same moment put it, and it moves where two
    such pairs after each other put it elsewhere (a restart, another estimator); without a local position, it is the first global
    position with a GNSS fix. A log without any position stays as it is. Of an autopilot that was restarted the origin of before
    stands until the log has another one.
    """
    events = recording.events
    if any(isinstance(event, OriginChanged) for _, event in events):
        return replace(recording, events=_told_again(events))
    found = _origins_of_pairs(events, recording.kind) or _first_position(events)
    if not found:
        return recording
    t_first = next(t for t, event in events if isinstance(event, PriorPose))
    made = list(events)
    for t_ns, origin in [*reversed(found[1:]), (t_first, found[0][1])]:
        made.insert(bisect.bisect_left(events, t_ns, key=lambda item: item[0]), (t_ns, OriginChanged(t_ns, origin)))
    return replace(recording, events=_told_again(made), origin_inferred=True)


def _told_again(events: list[tuple[int, Event]]) -> list[tuple[int, Event]]:
    """The events, with the last origin once more wherever the link came back: asked for again, and a log cannot answer."""
    told: list[tuple[int, Event]] = []
    last: OriginChanged | None = None
    was_down = False
    for t_ns, event in events:
        told.append((t_ns, event))
        if isinstance(event, OriginChanged):
            last = event
        elif isinstance(event, LinkChanged):
            if event.up and was_down and last is not None:
                told.append((t_ns, replace(last, t_rx_ns=t_ns)))
            was_down = not event.up
    return told


def _origins_of_pairs(events: list[tuple[int, Event]], kind: AutopilotKind) -> list[tuple[int, GeoPoint]]:
    """Times (ns) and places of the origins, the first and those that it moved to."""
    found: list[tuple[int, GeoPoint]] = []
    moved: GeoPoint | None = None
    for t_ns, origin in _pairs(events, kind):
        if not found:
            found.append((t_ns, origin))
        elif distance_m(origin, found[-1][1]) <= _MOVED_M:
            moved = None
        elif moved is not None and distance_m(origin, moved) <= _MOVED_M:
            found.append((t_ns, origin))
            moved = None
        else:
            moved = origin
    return found


def _pairs(events: list[tuple[int, Event]], kind: AutopilotKind) -> Iterator[tuple[int, GeoPoint]]:
    """Where local and global positions of the same moment, in either order, put the origin."""
    place: PriorPose | None = None
    local: LocalPose | None = None
    for t_ns, event in events:
        if isinstance(event, PriorPose):
            place = event
        elif isinstance(event, LocalPose) and event.t_boot_ns > 0 and any(event.p_ned_m[:2]):
            local = event
        else:
            continue
        if place is None or local is None:
            continue
        dt_ns = local.t_boot_ns - place.t_boot_ns
        if abs(dt_ns) <= _PAIR_NS:
            north, east, down = (p - v * dt_ns / NS_PER_S for p, v in zip(local.p_ned_m, local.v_ned_mps, strict=True))
            yield t_ns, geo_from_autopilot_ned(kind, (-north, -east, -down), place.place)


def _first_position(events: list[tuple[int, Event]]) -> list[tuple[int, GeoPoint]]:
    has_fix: dict[int, bool] = {}
    for t_ns, event in events:
        if isinstance(event, Gnss):
            has_fix[event.receiver] = event.fix_type >= FIX_3D
        elif isinstance(event, PriorPose) and any(has_fix.values()):
            return [(t_ns, GeoPoint(event.place.lat_deg, event.place.lon_deg, event.place.h_amsl_m - event.h_rel_m))]
    return []


def link_up(t_ns: int, kind: AutopilotKind, version: str = "", armed: bool = False) -> LinkChanged:
    """The event that opens a log of an autopilot's own (which has no heartbeat)."""
    return LinkChanged(t_ns, up=True, autopilot=kind, version=version, system_id=1, armed=armed)
