"""Telemetry logs of ground stations (.tlog): 8 bytes big-endian microseconds since 1970, then a MAVLink packet, repeated.

A lossy radio leaves pieces of broken packets between them; the reader finds the next record by its start byte, a plausible
time stamp and a right checksum, and counts what it skipped. One vehicle is read: the one whose heartbeats are most.
"""

from __future__ import annotations

import re
import statistics
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from visloc_companion.adapters.logs.boot_axis import BootAxis, Instant, smallest_difference_ns
from visloc_companion.adapters.logs.recording import NS_PER_MS, NS_PER_US, Losses, Recording, in_order, read_bytes
from visloc_companion.adapters.mavlink.codec import decode, is_autopilot
from visloc_companion.adapters.mavlink.dialect import Message, mav
from visloc_companion.adapters.mavlink.link_state import LinkState
from visloc_companion.errors import LogError
from visloc_companion.types import Event, LinkChanged

_STAMP = 8
_START = re.compile(b"[\xfd\xfe]")
_EARLIEST_US, _LATEST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2100: what a time stamp may say."""
_ANCHOR_RECORDS = 5000


@dataclass(frozen=True, slots=True)
class Record:
    """One packet with the ground station's stamp, microseconds since 1970."""

    wall_us: int
    message: Message


def read_tlog(path: Path) -> Recording:
    """The flight in a telemetry log. Raises LogError where there is no autopilot's message in it at all."""
    losses = Losses()
    records = list(records_of(read_bytes(path), losses))
    heard = _autopilots(records)
    if not heard:
        raise LogError("holds no MAVLink packet of an autopilot", where=str(path), remedy="name a telemetry log (.tlog)")
    own = [record for record in records if _source(record.message) == heard[0]]
    losses.foreign_messages = len(records) - len(own)
    zero_ns = _anchor_ns(own)
    axis, link = BootAxis(zero_ns, losses), LinkState()
    events: list[tuple[int, Event]] = []
    unix_ns: list[int] = []
    for record in own:
        instant = axis.place(record.wall_us, _boot_ms(record.message))
        unix_ns += _unix_minus_boot_ns(record.message, instant)
        if instant.rebooted:
            _append(events, instant, link.down(instant.t_ns))
        for event in decode(record.message, instant.t_ns):
            _append(events, instant, link.heard(event) if isinstance(event, LinkChanged) else _shifted(event, instant))
    if not events:
        raise LogError("holds no message that tells of a flight", where=str(path), remedy="record ATTITUDE and positions")
    utc_ns = round(statistics.median(unix_ns)) if unix_ns else zero_ns
    return Recording(path, link.known.autopilot, in_order(events), losses, utc_ns, not unix_ns, notes=_others_noted(heard))


def records_of(data: bytes, losses: Losses) -> Iterator[Record]:
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


def _record_at(data: bytes, at: int, parser: Any) -> tuple[Record | None, int]:
    """The record at a place and its length; (None, 0) where there is none."""
    start = at + _STAMP
    length = _packet_length(data, start)
    if length == 0 or start + length > len(data) or not _plausible_stamp(data, at):
        return None, 0
    try:
        message = parser.decode(bytearray(data[start : start + length]))
    except (mav.MAVError, struct.error, UnicodeDecodeError):
        return None, 0
    if message.get_msgId() < 0 and not _continues(data, start + length):
        return None, 0
    return Record(struct.unpack_from(">Q", data, at)[0], message), _STAMP + length


def _packet_length(data: bytes, start: int) -> int:
    """Length of the packet at a start byte, from its header; 0 where none starts."""
    if start + 3 > len(data):
        return 0
    if data[start] == mav.PROTOCOL_MARKER_V1:
        return 8 + data[start + 1]
    if data[start] == mav.PROTOCOL_MARKER_V2:
        return 12 + data[start + 1] + 13 * (data[start + 2] & int(mav.MAVLINK_IFLAG_SIGNED))
    return 0


def _plausible_stamp(data: bytes, at: int) -> bool:
    return bool(_EARLIEST_US <= struct.unpack_from(">Q", data, at)[0] <= _LATEST_US)


def _continues(data: bytes, at: int) -> bool:
    """Whether another record may start here: an unknown message has no checksum that could be verified."""
    if at == len(data):
        return True
    if at + _STAMP >= len(data):
        return False
    return _plausible_stamp(data, at) and data[at + _STAMP] in (mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2)


def _next_record(data: bytes, at: int, parser: Any) -> int:
    for found in _START.finditer(data, at + _STAMP):
        if _record_at(data, found.start() - _STAMP, parser)[0] is not None:
            return found.start() - _STAMP
    return len(data)


def _source(message: Message) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _autopilots(records: list[Record]) -> list[tuple[int, int]]:
    """System and component of the autopilots, that heard most first; a companion beside it has a boot clock of its own."""
    heard: Counter[tuple[int, int]] = Counter(
        _source(record.message) for record in records if record.message.get_type() == "HEARTBEAT" and is_autopilot(record.message)
    )
    return [source for source, _ in heard.most_common()]


def _others_noted(heard: list[tuple[int, int]]) -> tuple[str, ...]:
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


def _anchor_ns(records: list[Record]) -> int:
    stamps = [(r.wall_us, boot) for r in records[:_ANCHOR_RECORDS] if (boot := _boot_ms(r.message)) is not None]
    return smallest_difference_ns(stamps) if stamps else records[0].wall_us * 1000


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
