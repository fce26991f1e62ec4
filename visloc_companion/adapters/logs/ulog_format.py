"""The framing of PX4's ULog files: a header, then messages (size, type, body) that define formats, subscribe and carry data.

pyulog reads such files too, but loops without end on some damaged ones; a damaged place is skipped here and counted.
Format: docs.px4.io, "ULog File Format".
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from visloc_companion.adapters.logs.recording import LogBytes, Losses

MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES = 16
_TYPES = frozenset(b"BFIMPQALRCDSO")
_READ = re.compile(b"[FAD]")
_DEMANDED = {
    ord("F"): re.compile(rb"[\w/-]+:[ -~]"),
    ord("A"): re.compile(rb"(?s:...)[\w/-]+\Z"),
    **dict.fromkeys(b"IP", re.compile(rb"(?s:[^\0])[ -~]")),
    **dict.fromkeys(b"MQ", re.compile(rb"(?s:.[^\0])[ -~]")),
}
"""What bodies begin with: a topic's name (of a subscription behind its numbers, to the end), or a key behind its length."""
_SIZES = {ord("S"): 8, ord("O"): 2, ord("R"): 2}
"""Of types whose bodies have but one."""
_WHOLE_FORMAT = re.compile(rb"[\w/-]+:[\w/]+(?:\[\d+\])? \w+(?:;[\w/]+(?:\[\d+\])? \w+)*;?")
_CODES = {
    **{"int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I"},
    **{"int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "c"},
}
_LONG_BYTES, _FOLLOWING = 2048, 5
_MOST_NUMBERS = 4096
"""Logs number their subscriptions from 0 and have some hundreds."""
_HEAD, _NUMBER = struct.Struct("<HB"), struct.Struct("<H")
"""A message's size and type; a subscription's number, a size alone, or a dropout's milliseconds."""
_DATA = ord("D")
_FIELD = re.compile(r"^(\w+?)(?:\[(\d+)\])? (\w+)$")
Row = Mapping[str, Any]
Instances = dict[int, list[Row]]
"""Rows of one topic by its instances' numbers."""
_Subscription = tuple[int, str]
"""Instance and topic."""


class _Format:
    """Names and struct codes of a topic's fields, and its size with trailing padding, which most data messages leave out."""

    def __init__(self, names: list[str], codes: list[str]) -> None:
        self.padded = struct.calcsize("<" + "".join(codes))
        while names and names[-1].startswith("_padding"):
            names.pop()
            codes.pop()
        self.size = struct.calcsize("<" + "".join(codes))
        ends = accumulate(struct.calcsize("<" + code) for code in codes)
        self.fields = {
            name: (struct.Struct("<" + code), end - struct.calcsize("<" + code))
            for name, code, end in zip(names, codes, ends, strict=True)
        }


class _StoredRow(Mapping[str, Any]):
    """A row as it is stored; its fields are taken out where they are asked for: all by name take a dozen times the log."""

    __slots__ = ("_format", "_stored")

    def __init__(self, known: _Format, stored: bytes) -> None:
        self._format, self._stored = known, stored

    def __getitem__(self, name: str) -> Any:
        layout, at = self._format.fields[name]
        return layout.unpack_from(self._stored, at)[0]

    def __iter__(self) -> Iterator[str]:
        return iter(self._format.fields)

    def __len__(self) -> int:
        return len(self._format.fields)

    def __contains__(self, name: object) -> bool:
        return name in self._format.fields


def read_topics(data: LogBytes, wanted: Collection[str], losses: Losses) -> dict[str, list[Row]]:
    """Rows of the wanted topics, the first instance of each; the rest: `read_instances`."""
    return {name: of_first(instances) for name, instances in read_instances(data, wanted, losses).items()}


def of_first(instances: Instances) -> list[Row]:
    """Rows of the instance with the least number."""
    return instances[min(instances)]


def read_instances(data: LogBytes, wanted: Collection[str], losses: Losses) -> dict[str, Instances]:
    """Rows of the wanted topics, instance by instance, in the order of the file. Never raises for what bytes may hold.

    What is long, or longer than the file, is no message where such as bear themselves out lie within it.
    A subscription whose topic has no format that can be read, and data without a subscription, count as unknown: a bit that flips
    in either hides a whole topic.
    """
    formats: dict[str, _Format | None] = {}
    subscribed: dict[int, _Subscription] = {}
    found: dict[_Subscription, list[Row]] = {}
    known = _Known(formats, subscribed)
    at = _HEADER_BYTES
    while at + 3 <= len(data):
        size, kind = _HEAD.unpack_from(data, at)
        end = at + 3 + size
        far = size > _LONG_BYTES or end > len(data)
        if not _plausible(data, at, known) or (far and _next_sure(data, at, end, known) is not None):
            at = _resynchronised(data, at, known, losses)
            continue
        if end > len(data):
            losses.truncated = True
            break
        body = data[at + 3 : end]
        if kind == ord("F"):
            _learn(formats, body)
        elif kind == ord("A") and size > 3:
            multi_id, number = struct.unpack_from("<BH", body)
            name = body[3:].decode("ascii", errors="replace")
            if name not in formats or (name in wanted and formats[name] is None):
                losses.unknown_messages += 1
            elif number not in subscribed:
                subscribed[number] = (multi_id, name)
            elif subscribed[number] != (multi_id, name):
                losses.unknown_messages += 1
        elif kind == _DATA and size > 2:
            _take(body, formats, subscribed, wanted, found, losses)
        elif kind == ord("O"):
            losses.dropouts += 1
            losses.dropouts_ms += _NUMBER.unpack(body)[0]
        at = end
    topics: dict[str, Instances] = {}
    for (instance, name), rows in found.items():
        topics.setdefault(name, {})[instance] = rows
    return topics


@dataclass(frozen=True, slots=True)
class _Known:
    """What the log has defined so far, by which a message bears itself out: the format has no checksums."""

    formats: dict[str, _Format | None]
    subscribed: dict[int, _Subscription]

    def bears_out(self, data: LogBytes, at: int) -> bool:
        """Whether a message that is read starts here beyond doubt: data of the very size that its topic has, a whole format, or a
        subscription to one."""
        if at < 0 or at + 5 > len(data):
            return False
        size, kind = _HEAD.unpack_from(data, at)
        if at + 3 + size > len(data):
            return False
        if kind == ord("F"):
            return _WHOLE_FORMAT.fullmatch(data, at + 3, at + 3 + size) is not None
        if kind == ord("A"):
            return data[at + 6 : at + 3 + size].decode("ascii", errors="replace") in self.formats
        subscription = self.subscribed.get(_NUMBER.unpack_from(data, at + 3)[0]) if kind == _DATA else None
        layout = None if subscription is None else self.formats.get(subscription[1])
        return layout is not None and layout.size <= size - 2 <= layout.padded

    def may_be(self, data: LogBytes, at: int) -> bool:
        """Whether the bytes may be a message, by what its type demands of them."""
        size, kind = _HEAD.unpack_from(data, at)
        if kind not in _TYPES or size == 0:
            return False
        if kind == _DATA:  # nearly all are
            return at + 5 > len(data) or bool(_NUMBER.unpack_from(data, at + 3)[0] < _MOST_NUMBERS)
        if kind in _SIZES:
            return bool(size == _SIZES[kind])
        demanded = _DEMANDED.get(kind)
        return demanded is None or demanded.match(data, at + 3, min(at + 3 + size, len(data))) is not None


def _plausible(data: LogBytes, at: int, known: _Known) -> bool:
    """Whether a message starts here: a known type, and another one (or the file's end) behind it, behind a long one several.

    A bit that flips in a size leads far away, where one byte is a type by chance.
    """
    size = _NUMBER.unpack_from(data, at)[0]
    for _ in range(1 if size <= _LONG_BYTES else _FOLLOWING):
        if not known.may_be(data, at):
            return False
        at += 3 + _NUMBER.unpack_from(data, at)[0]
        if at + 3 > len(data):
            return True
    return known.may_be(data, at)


def _next_sure(data: LogBytes, at: int, stop: int, known: _Known) -> int | None:
    """Where the next message begins that bears itself out, behind the place and before another."""
    for kind in _READ.finditer(data, at + 3, min(stop, len(data))):  # zeros that a loss of power leaves may be megabytes
        if known.bears_out(data, kind.start() - 2):
            return kind.start() - 2
    return None


def _resynchronised(data: LogBytes, at: int, known: _Known, losses: Losses) -> int:
    sure = _next_sure(data, at, len(data), known)
    start = len(data) if sure is None else sure
    losses.garbage_pieces += 1
    losses.garbage_bytes += start - at
    return start


def _learn(formats: dict[str, _Format | None], body: bytes) -> None:
    """Take a format whose fields are all of basic types; others are not needed, and only their names are kept."""
    name, _, listed = body.decode("ascii", errors="replace").partition(":")
    formats.setdefault(name, None)
    names: list[str] = []
    codes: list[str] = []
    for part in filter(None, listed.split(";")):
        field = _FIELD.match(part)
        code = _CODES.get(field.group(1)) if field else None
        if field is None or code is None:
            return
        count, own = int(field.group(2) or 0), field.group(3)
        if count > 1024:
            return
        names += [f"{own}[{k}]" for k in range(count)] if count else [own]
        codes += [code] * max(count, 1)
    if "timestamp" in names:
        formats[name] = _Format(names, codes)


def _take(
    body: bytes,
    formats: dict[str, _Format | None],
    subscribed: dict[int, _Subscription],
    wanted: Collection[str],
    found: dict[_Subscription, list[Row]],
    losses: Losses,
) -> None:
    subscription = subscribed.get(_NUMBER.unpack_from(body)[0])
    if subscription is None:
        losses.unknown_messages += 1
        return
    known = formats[subscription[1]]
    if known is None or subscription[1] not in wanted:
        return
    if not known.size <= len(body) - 2 <= known.padded:
        losses.dropped_messages += 1
        return
    found.setdefault(subscription, []).append(_StoredRow(known, body[2:]))
