"""Telemetry logs of ground stations (.tlog): 8 bytes big-endian microseconds since 1970, then a MAVLink packet, repeated.

A lossy radio leaves pieces of broken packets between them; the reader finds the next record by its start byte, a plausible
time stamp and a right checksum, and counts what it skipped. One vehicle is read: the one that is named, else the one whose
heartbeats are most.
"""

from __future__ import annotations

import re
import statistics
import struct
from array import array
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from visloc_companion.adapters.logs.boot_axis import BootAxis, Instant, smallest_difference_ns
from visloc_companion.adapters.logs.recording import (
    BY_GPS_INPUT,
    FIRST_GPS_TYPE,
    FIRST_IS_PLAYED,
    NS_PER_MS,
    NS_PER_US,
    SECOND_GPS_TYPE,
    LogBytes,
    Losses,
    Recording,
    in_order,
    read_bytes,
)
from visloc_companion.adapters.mavlink.codec import DECODED, decode, is_autopilot
from visloc_companion.adapters.mavlink.codec_gimbal import is_of_gimbal
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.link_state import LinkState
from visloc_companion.errors import LogError
from visloc_companion.types import FIX_3D, Event, LinkChanged

_STAMP = 8
_START = re.compile(b"[\xfd\xfe]")
_EARLIEST_US, _LATEST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2100: what an autopilot may say of UTC. Stamps begin in 1970, as computers without a clock do."""
_ANCHOR_RECORDS = 5000
_TOLD = frozenset(number for number, kind in mav.mavlink_map.items() if kind.msgname in {*DECODED, "SYSTEM_TIME", "GPS_RAW_INT"})
"""Numbers of the messages that tell of the flight or its clocks: most of a log does not, beside the boot time."""
_Source = tuple[int, int]
"""System and component."""


@dataclass(frozen=True, slots=True)
class Record:
    """One packet: where its record begins in the file, the ground station's stamp, microseconds since 1970, and what it says."""

    at: int
    wall_us: int
    message: Message


@dataclass(slots=True)
class _Packets:
    """Of all packets, in the order of the file: where their records begin, and their boot time (ms), 0 where they state none."""

    at: array[int] = field(default_factory=lambda: array("q"))
    boot_ms: array[int] = field(default_factory=lambda: array("q"))

    def add(self, record: Record, boot_ms: int | None) -> None:
        """One more."""
        self.at.append(record.at)
        self.boot_ms.append(boot_ms or 0)


@dataclass(slots=True)
class _Heard:
    """Of one source: packets, heartbeats of an autopilot, its first stamp, (stamp, boot time, ms) of the first few, the boot time
    (ms) of each packet that states it and is not a gimbal's, and whether its receivers are ones that a companion plays."""

    records: int = 0
    heartbeats: int = 0
    first_us: int = 0
    stamps: list[tuple[int, int]] = field(default_factory=list)
    boots_ms: array[int] = field(default_factory=lambda: array("q"))
    first_is_played: bool = False
    second_is_played: bool = False

    def add(self, record: Record, boot_ms: int | None) -> None:
        """Take its next packet, which states a boot time or none."""
        self.first_us = self.first_us or record.wall_us
        self.records += 1
        self.heartbeats += record.message.get_type() == "HEARTBEAT" and is_autopilot(record.message)
        if record.message.get_type() == "PARAM_VALUE" and record.message.param_id in (*FIRST_GPS_TYPE, *SECOND_GPS_TYPE):
            is_played = record.message.param_value == BY_GPS_INPUT
            if record.message.param_id in SECOND_GPS_TYPE:
                self.second_is_played = is_played
            else:
                self.first_is_played = is_played
        if boot_ms is None:
            return
        if self.records <= _ANCHOR_RECORDS:
            self.stamps.append((record.wall_us, boot_ms))
        if not is_of_gimbal(record.message):
            self.boots_ms.append(boot_ms)

    @property
    def zero_ns(self) -> int:
        """UTC of the boot, by the packet that came soonest."""
        return smallest_difference_ns(self.stamps) if self.stamps else self.first_us * NS_PER_US


def read_tlog(path: Path, system_id: int = 0) -> Recording:
    """The flight of a vehicle in a telemetry log, with `system_id` 0 of the one whose heartbeats are most.

    Raises LogError where no autopilot of it is heard.
    """
    data, losses = read_bytes(path), Losses()
    sources, packets = _survey(data, losses)
    heard = sorted((source for source in sources if sources[source].heartbeats), key=lambda s: -sources[s].heartbeats)
    if not heard:
        raise LogError("holds no MAVLink packet of an autopilot", where=str(path), remedy="name a telemetry log (.tlog)")
    if system_id:
        heard.sort(key=lambda source: source[0] != system_id)
        if heard[0][0] != system_id:
            there = ", ".join(str(system) for system in sorted({system for system, _ in heard}))
            raise LogError(
                f"holds no autopilot of system {system_id}", where=str(path), remedy=f"name one that is there: {there}"
            )
    losses.foreign_messages = sum(found.records for found in sources.values()) - sources[heard[0]].records
    zero_ns = sources[heard[0]].zero_ns
    axis, link = BootAxis(zero_ns, losses), LinkState()
    events: list[tuple[int, Event]] = []
    unix_ns: dict[bool, list[int]] = {True: [], False: []}
    has_fix: bool | None = None
    boots_ms, n_stamped = sources[heard[0]].boots_ms, 0
    parser = mav.MAVLink(None)
    for at, stated_ms in zip(packets.at, packets.boot_ms, strict=True):
        source, number = _addressed(data, at + _STAMP)
        if source[0] != heard[0][0] or (source != heard[0] and number not in _TOLD):
            continue
        message = _message_at(data, at, parser) if number in _TOLD else None
        own_clock = message is not None and is_of_gimbal(message)
        if source != heard[0] and not own_clock:
            continue
        boot_ms = None if own_clock else stated_ms or None
        instant = axis.place(_stamp_us(data, at), boot_ms, boots_ms[n_stamped] if n_stamped < len(boots_ms) else None)
        n_stamped += boot_ms is not None
        if instant.rebooted:
            _append(events, instant, link.down(instant.t_ns))
        if message is None:
            continue
        if message.get_type() == "GPS_RAW_INT":
            has_fix = message.fix_type >= FIX_3D
        unix_ns[bool(has_fix)] += _unix_minus_boot_ns(message, instant)
        if sources[heard[0]].second_is_played and message.get_type() == "GPS2_RAW":
            continue
        for event in decode(message, instant.t_ns):
            _append(events, instant, link.heard(event) if isinstance(event, LinkChanged) else _shifted(event, instant))
    if not events:
        raise LogError("holds no message that tells of a flight", where=str(path), remedy="record ATTITUDE and positions")
    told_ns = unix_ns[True] or unix_ns[False]  # without a fix PX4 takes a ground station's clock
    utc_ns = round(statistics.median(told_ns)) if told_ns else zero_ns
    notes = (*_others_noted(heard), *([FIRST_IS_PLAYED] if sources[heard[0]].first_is_played else []))
    of_station = not told_ns or (has_fix is not None and not unix_ns[True])
    return Recording(path, link.known.autopilot, in_order(events), losses, utc_ns, of_station, notes=notes)


def records_of(data: LogBytes, losses: Losses) -> Iterator[Record]:
    """The packets with a right checksum, in the order of the file. Never raises for what the bytes may hold."""
    parser = mav.MAVLink(None)
    at = 0
    while at + _STAMP < len(data):
        record, length = _record_at(data, at, parser)
        if record is None:
            following = _next_record(data, at + 1, parser)
            losses.garbage_pieces += 1
            losses.garbage_bytes += following - at
            losses.truncated |= following >= len(data)
            at = following
            continue
        if record.message.get_msgId() < 0:
            losses.unknown_messages += 1
        else:
            yield record
        at += length


def _record_at(data: LogBytes, at: int, parser: Any) -> tuple[Record | None, int]:
    """The record at a place and its length; (None, 0) where there is none."""
    start = at + _STAMP
    length = packet_length(data, start)
    if length == 0 or start + length > len(data) or not _plausible_stamp(data, at):
        return None, 0
    try:
        message = parser.decode(bytearray(data[start : start + length]))
    except (mav.MAVError, struct.error, UnicodeDecodeError):
        return None, 0
    if message.get_msgId() < 0 and not _continues(data, start + length):
        return None, 0
    return Record(at, _stamp_us(data, at), message), _STAMP + length


def _message_at(data: LogBytes, at: int, parser: Any) -> Message | None:
    """The message of a record that is there."""
    record, _ = _record_at(data, at, parser)
    return None if record is None else record.message


def _addressed(data: LogBytes, start: int) -> tuple[_Source, int]:
    """Source and number of the message of the packet at a start byte."""
    if data[start] == mav.PROTOCOL_MARKER_V1:
        return (data[start + 3], data[start + 4]), data[start + 5]
    return (data[start + 5], data[start + 6]), int.from_bytes(data[start + 7 : start + 10], "little")


def packet_length(data: LogBytes, start: int) -> int:
    """Length of the packet at a start byte, from its header; 0 where none starts."""
    if start + 3 > len(data):
        return 0
    if data[start] == mav.PROTOCOL_MARKER_V1:
        return 8 + data[start + 1]
    if data[start] == mav.PROTOCOL_MARKER_V2:
        return 12 + data[start + 1] + 13 * (data[start + 2] & int(mav.MAVLINK_IFLAG_SIGNED))
    return 0


def _stamp_us(data: LogBytes, at: int) -> int:
    return int.from_bytes(data[at : at + _STAMP], "big")


def _plausible_stamp(data: LogBytes, at: int) -> bool:
    return 0 < _stamp_us(data, at) <= _LATEST_US


def _continues(data: LogBytes, at: int) -> bool:
    """Whether another record may start here: an unknown message has no checksum that could be verified."""
    if at == len(data):
        return True
    if at + _STAMP >= len(data):
        return False
    return _plausible_stamp(data, at) and data[at + _STAMP] in (mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2)


def _next_record(data: LogBytes, at: int, parser: Any) -> int:
    for found in _START.finditer(data, at + _STAMP):
        if _record_at(data, found.start() - _STAMP, parser)[0] is not None:
            return found.start() - _STAMP
    return len(data)


def _source(message: Message) -> _Source:
    return message.get_srcSystem(), message.get_srcComponent()


def _survey(data: LogBytes, losses: Losses) -> tuple[dict[_Source, _Heard], _Packets]:
    """What is heard of each source, and where; a companion beside an autopilot has a boot clock of its own.

    The file is gone through once for this, and what tells of the flight is decoded once more for the events: its messages, kept,
    would take 33 times its size.
    """
    sources: defaultdict[_Source, _Heard] = defaultdict(_Heard)
    packets = _Packets()
    for record in records_of(data, losses):
        boot_ms = _boot_ms(record.message)
        sources[_source(record.message)].add(record, boot_ms)
        packets.add(record, boot_ms)
    return sources, packets


def _others_noted(heard: list[_Source]) -> tuple[str, ...]:
    others = ", ".join(f"{system} (component {component})" for system, component in sorted(heard[1:]))
    return (f"The log holds other autopilots, which were left out: {others}; read was {heard[0][0]}.",) if others else ()


def _unix_minus_boot_ns(message: Message, instant: Instant) -> list[int]:
    """What SYSTEM_TIME says of UTC, on the recording's clock; nothing before the autopilot knows it."""
    if message.get_type() != "SYSTEM_TIME" or not _EARLIEST_US <= message.time_unix_usec <= _LATEST_US:
        return []
    boot_ns = message.time_boot_ms * NS_PER_MS + instant.boot_shift_ns
    return [message.time_unix_usec * NS_PER_US - boot_ns] if message.time_boot_ms else []


def _boot_ms(message: Message) -> int | None:
    boot_ms = getattr(message, "time_boot_ms", None)
    return int(boot_ms) if boot_ms else None


def _shifted(event: Event, instant: Instant) -> Event:
    """The event with its boot time continued across reboots."""
    boot_ns = getattr(event, "t_boot_ns", None)
    if not boot_ns or not instant.boot_shift_ns:
        return event
    changed: Any = event
    moved: Event = replace(changed, t_boot_ns=boot_ns + instant.boot_shift_ns)
    return moved


def _append(events: list[tuple[int, Event]], instant: Instant, event: Event | None) -> None:
    if event is not None:
        events.append((instant.t_ns, event))
