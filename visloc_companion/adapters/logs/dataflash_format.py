"""The self-describing framing of ArduPilot's DataFlash logs (.bin): 0xA3 0x95, a type, then fields as an FMT message names them.

pymavlink's own DFReader loads such files too, but writes what it meets in damaged ones to the terminal and can stop in the
middle of them; its table of field types is used here.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from visloc_companion.adapters.logs.recording import LogBytes, Losses

_HEAD = b"\xa3\x95"
_FMT_TYPE, _FMT_LENGTH = 0x80, 89
BEGINNING = _HEAD + bytes((_FMT_TYPE, _FMT_TYPE, _FMT_LENGTH)) + b"FMT\0"
"""Of each log: the format of the formats."""
_FMT = struct.Struct("<BB4s16s64s")
Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Format:
    name: str
    length: int
    layout: struct.Struct
    columns: tuple[str, ...]
    multipliers: tuple[float | None, ...]


Formats = dict[int, _Format]
"""By the number that messages bear."""


def messages(
    data: LogBytes, wanted: Collection[str], losses: Losses, begin: int, stop: int, formats: Formats
) -> Iterator[tuple[str, Fields]]:
    """Names and fields (in the units of the log's multipliers) of the wanted messages, in the order of the file; of the log that
    lies from byte `begin` to `stop`.

    `formats` are those known before, and get what it defines: that of the formats themselves need not be the first of a log. They
    end with a log that holds messages, for the next one may be of another version. Bytes that are no message are skipped and
    counted. Never raises for what the bytes may hold.
    """
    at, has_messages = begin, False
    while (start := data.find(_HEAD, at, stop)) >= 0:
        _count_garbage(losses, start - at)
        length = _length_at(data, start, stop, formats)
        if length == 0 or not _followed(data, start + length, stop):
            losses.garbage_pieces += 1
            losses.garbage_bytes += 2
            losses.truncated |= length > 0 and start + length > stop
            at = start + 2
            continue
        kind, body = data[start + 2], data[start + 3 : start + length]
        if kind == _FMT_TYPE:
            _learn(formats, body)
        else:
            has_messages = True
            if formats[kind].name in wanted:
                yield formats[kind].name, _fields(formats[kind], body)
        at = start + length
    _count_garbage(losses, stop - at)
    if has_messages:
        formats.clear()


def _count_garbage(losses: Losses, n_bytes: int) -> None:
    if n_bytes > 0:
        losses.garbage_pieces += 1
        losses.garbage_bytes += n_bytes


def _length_at(data: LogBytes, start: int, stop: int, formats: Formats) -> int:
    if start + 3 > stop:
        return 0
    kind = data[start + 2]
    if kind == _FMT_TYPE:
        return _FMT_LENGTH
    known = formats.get(kind)
    return known.length if known else 0


def _followed(data: LogBytes, end: int, stop: int) -> bool:
    """Whether a message may end here: the log's end or the next header (there are no checksums in this format).

    Where a block of zeros follows, as cards leave it, the message must not end in one: it may have lost its end to the block.
    """
    following = data[end : min(end + 64, stop)]
    if end == stop or following[:2] in (_HEAD, _HEAD[:1]):
        return True
    return end < stop and data[end - 1] != 0 and not any(following)


def _learn(formats: Formats, body: bytes) -> None:
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    kind, length, name, layout, columns = _FMT.unpack(body)
    names = tuple(part for part in _text(columns).split(",") if part)
    types = [FORMAT_TO_STRUCT.get(letter) for letter in _text(layout)]
    if kind == _FMT_TYPE or None in types or len(types) != len(names):
        return
    known = [item for item in types if item is not None]
    packed = struct.Struct("<" + "".join(item[0] for item in known))
    if packed.size + 3 == length:
        formats[kind] = _Format(_text(name), length, packed, names, tuple(item[1] for item in known))


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", errors="replace")


def _fields(layout: _Format, body: bytes) -> Fields:
    values = layout.layout.unpack(body)
    return {
        name: value * factor if factor is not None and not isinstance(value, bytes) else value
        for name, value, factor in zip(layout.columns, values, layout.multipliers, strict=True)
    }
