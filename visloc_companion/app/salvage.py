"""Reading MCAP files that may have lost their end or some of their bytes.

The library's readers stop at the first damage and check no chunk unless asked. This one walks the records in file order,
checks every chunk's CRC, and after damage searches for the next whole chunk, so a killed writer costs the last chunk and a
flipped byte costs one. Of two journals that were joined the first is read: the second's times are of another boot. A journal
that MCAP's own tools wrote anew may have chunks that are not compressed, or by LZ4. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from mmap import mmap
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel

from visloc_companion.errors import JournalError

MAGIC = b"\x89MCAP0\r\n"
_BEGINNING = MAGIC + bytes([int(Opcode.HEADER)])
_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQ8x")
"""Channel, sequence and time of the record; the time of publication is left out."""
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_LENGTH = struct.Struct("<I")
_ZSTD = b"zstd"
_MARK = _LENGTH.pack(len(_ZSTD)) + _ZSTD
"""The compression field of every chunk that the journal writes; the search for the next chunk looks for it."""
_MARK_OFFSET = _RECORD.size + _CHUNK.size
_MAX_CHUNK_BYTES = 512 * 2**20
_LAST_OPCODE = int(Opcode.DATA_END)
_FOOTER_BYTES = 20

_SOMETHING = re.compile(rb"[^\0]")
OnDamage = Callable[[str], None]


_DECOMPRESS: dict[bytes, Callable[[bytes, int], bytes]] = {
    _ZSTD: lambda body, size: zstandard.ZstdDecompressor().decompress(body),
    b"lz4": lambda body, size: bytes(lz4.frame.LZ4FrameDecompressor().decompress(body, max_length=size)),
    b"": lambda body, size: body,
}
"""By the name that a chunk states, of its body and the size that it is to have."""


class Record(NamedTuple):
    """One message of the file. `topic` is None where the channel's description was lost."""

    topic: str | None
    log_time_ns: int
    sequence: int
    data: bytes


class _DamageError(Exception):
    pass


class _CutError(_DamageError):
    """The file ends where its writer was, which is no damage of one that is being written."""


def read_records(data: bytes | mmap, where: str, on_damage: OnDamage, *, written: bool = False) -> Iterator[Record]:
    """Messages in file order. Raises JournalError where the file is no MCAP at all; all else is told to `on_damage`.

    `written`: somebody writes the file still, so that its end is not there yet.
    """
    if data[: len(MAGIC)] != MAGIC:
        raise JournalError("is not a journal (no MCAP signature)", where=where, remedy="name a .mcap file that visloc wrote")
    topics: dict[int, str] = {}
    position = len(MAGIC)
    while True:
        try:
            opcode, end = _frame(data, position)
            messages = list(_chunk(data[position + _RECORD.size : end], topics)) if opcode == Opcode.CHUNK else []
        except _DamageError as why:
            writer = "it is being written" if written else "the writer was killed"
            on_damage(f"byte {position}: {why}{f' ({writer})' if isinstance(why, _CutError) else ''}")
            following = _next_chunk(data, position + 1)
            if following is None or _another_begins(data, position, following, on_damage):
                return
            position = following
            continue
        yield from messages
        # a record that was cut may span the beginning of the next file
        until = len(data) if opcode == Opcode.FOOTER else end + len(_BEGINNING)
        if opcode != Opcode.CHUNK and (_another_begins(data, position, until, on_damage) or opcode == Opcode.FOOTER):
            return
        position = end


def _another_begins(data: bytes | mmap, start: int, end: int, on_damage: OnDamage) -> bool:
    """Whether a second file begins between two bytes; told."""
    at = data.find(_BEGINNING, start, end)
    if at >= 0:
        on_damage(f"another journal begins at byte {at} and is not read (tail -c +{at + 1} makes a file of it)")
    return at >= 0


def _frame(data: bytes | mmap, position: int) -> tuple[int, int]:
    """Opcode and end of the record at a position."""
    if position + _RECORD.size > len(data):
        raise _CutError("the file ends before its end was written")
    opcode, length = _RECORD.unpack_from(data, position)
    if opcode == 0 and _SOMETHING.search(data, position) is None:
        raise _DamageError("the file ends in zeros (the power was cut)")
    if not 0 < opcode <= _LAST_OPCODE:
        raise _DamageError(f"record of unknown type {opcode}")
    if opcode == Opcode.FOOTER and length != _FOOTER_BYTES:
        raise _DamageError(f"an end of {length} bytes, where {_FOOTER_BYTES} are right")
    end = position + _RECORD.size + length
    if end > len(data):
        raise _CutError("the file ends in the middle of a record")
    return opcode, end


def _chunk(payload: bytes, topics: dict[int, str]) -> Iterator[Record]:
    """Messages of a chunk; learns the channels that it describes."""
    try:
        records = _decompressed(payload)
        at = 0
        while at < len(records):
            opcode, length = _RECORD.unpack_from(records, at)
            begin, at = at + _RECORD.size, at + _RECORD.size + length
            if at > len(records) or (opcode == _MESSAGE_OPCODE and length < _MESSAGE.size):
                raise ValueError("it ends in the middle of a record")
            if opcode == _MESSAGE_OPCODE:
                channel_id, sequence, log_time_ns = _MESSAGE.unpack_from(records, begin)
                yield Record(topics.get(channel_id), log_time_ns, sequence, records[begin + _MESSAGE.size : at])
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(records[begin:at])))
                topics[channel.id] = channel.topic
    except (McapError, struct.error, ValueError, RuntimeError, zstandard.ZstdError, MemoryError) as why:
        raise _DamageError(f"a chunk is damaged ({why})") from why


def _decompressed(payload: bytes) -> bytes:
    """Uncompressed records of a chunk, its CRC checked."""
    size, crc, n_name = _CHUNK.unpack_from(payload)[2:] + _LENGTH.unpack_from(payload, _CHUNK.size)
    name, body = payload[_CHUNK.size + 4 : _CHUNK.size + 4 + n_name], payload[_CHUNK.size + 4 + n_name + 8 :]
    if name not in _DECOMPRESS:
        raise ValueError("its compression is unknown")
    if size > _MAX_CHUNK_BYTES or (name == _ZSTD and zstandard.frame_content_size(body) != size):
        raise ValueError("its size is wrong")
    data = _DECOMPRESS[name](body, size)
    if len(data) != size:
        raise ValueError("its size is wrong")
    if zlib.crc32(data) != crc:
        raise ValueError("its CRC is wrong")
    return data


def _next_chunk(data: bytes | mmap, start: int) -> int | None:
    """Position of the next record that looks like a chunk."""
    while (mark := data.find(_MARK, start + _MARK_OFFSET)) >= 0:
        position = mark - _MARK_OFFSET
        if data[position] == Opcode.CHUNK:
            return position
        start = position + 1
    return None
