"""Damaged journals: what is whole is read, nothing else happens than a JournalError."""

from __future__ import annotations

import re
import struct
import zlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import zstandard
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, read_header, read_journal
from visloc_companion.app.salvage import MAGIC, read_records
from visloc_companion.errors import JournalError
from visloc_companion.types import Attitude


@cache
def whole() -> tuple[bytes, tuple[Entry, ...]]:
    """A journal of several chunks and its entries."""
    rng = np.random.default_rng(5)
    with TemporaryDirectory() as folder:
        writer = JournalWriter.create(Path(folder), JournalHeader({"seed": 1}), max_bytes=10**7)
        for i in range(2500):
            quat, rates = rng.normal(size=4).tolist(), rng.normal(size=3).tolist()
            writer.event(i, Attitude(i, i, (quat[0], quat[1], quat[2], quat[3]), (rates[0], rates[1], rates[2])))
        writer.close()
        assert writer.path is not None
        return writer.path.read_bytes(), tuple(read_journal(writer.path, salvage=False))


def entries_of(path: Path, data: bytes) -> tuple[list[Entry], list[str]]:
    path.write_bytes(data)
    damage: list[str] = []
    return list(read_journal(path, on_damage=damage.append)), damage


@given(share=st.floats(0, 1))
@settings(max_examples=40)
def test_cut_anywhere(share: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    data, entries = whole()
    cut = round(share * len(data))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    if cut < len(MAGIC):
        with pytest.raises(JournalError):
            entries_of(path, data[:cut])
        return
    kept, damage = entries_of(path, data[:cut])
    assert tuple(kept) == entries[: len(kept)]
    assert len(damage) == (cut < len(data) - len(MAGIC))


def test_cut_at_every_byte_of_the_first_and_last_records(tmp_path: Path) -> None:
    data, entries = whole()
    for cut in (*range(8, 80), *range(len(data) - 60, len(data))):
        kept, _ = entries_of(tmp_path / "cut.mcap", data[:cut])
        assert tuple(kept) == entries[: len(kept)]


@given(flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4))
@example(flips=[(0.0, 3)]).via("the type of the first record becomes that of the last, behind which nothing is read")
@settings(max_examples=40)
def test_flipped_bytes_cost_their_chunks_only(flips: list[tuple[float, int]], tmp_path_factory: pytest.TempPathFactory) -> None:
    data, entries = whole()
    damaged = bytearray(data)
    for share, flip in flips:
        damaged[len(MAGIC) + int(share * (len(data) - len(MAGIC)))] ^= flip
    kept, damage = entries_of(tmp_path_factory.getbasetemp() / "flipped.mcap", bytes(damaged))
    at = {entry.now_ns: entry for entry in entries}
    assert all(at[entry.now_ns] == entry for entry in kept)
    assert [entry.now_ns for entry in kept] == sorted(entry.now_ns for entry in kept)
    assert len(kept) == len(entries) or damage


def test_zeros_at_the_end_are_told_as_a_cut(tmp_path: Path) -> None:
    """Blocks that the file system had promised when the power went; "record of unknown type 0" sounds like another fault."""
    data, entries = whole()
    third = [match.start() for match in re.finditer(re.escape(b"\x04\x00\x00\x00zstd"), data)][2] - 37
    for cut, told in ((third, "the file ends in zeros (the power was cut)"), (third + 500, "a chunk is damaged (")):
        kept, damage = entries_of(tmp_path / "cut.mcap", data[:cut] + bytes(100_000))
        assert kept and tuple(kept) == entries[: len(kept)] and len(kept) < len(entries)
        assert damage[0].startswith(f"byte {third}: {told}") and len(damage) == 1


def test_a_flipped_length_costs_one_chunk_and_is_told(tmp_path: Path) -> None:
    data, entries = whole()
    mark = b"\x04\x00\x00\x00zstd"
    third = [match.start() for match in re.finditer(re.escape(mark), data)][2] - 37
    damaged = bytearray(data)
    damaged[third + 3] ^= 0x10
    kept, damage = entries_of(tmp_path / "x.mcap", bytes(damaged))
    assert damage
    assert 0 < len(entries) - len(kept) < len(entries) / 2
    assert kept[0] == entries[0]
    assert kept[-1] == entries[-1]


def test_without_its_first_chunk_the_rest_is_still_read(tmp_path: Path) -> None:
    data, entries = whole()
    damaged = bytearray(data)
    damaged[data.index(b"\x04\x00\x00\x00zstd") + 30] ^= 1
    path = tmp_path / "x.mcap"
    kept, damage = entries_of(path, bytes(damaged))
    assert damage
    assert kept
    assert kept[-1] == entries[-1]
    with pytest.raises(JournalError, match="holds no header"):
        read_header(path)


@given(st.binary(max_size=300))
@settings(max_examples=100)
def test_rubbish_after_the_signature_ends_quietly(rubbish: bytes) -> None:
    damage: list[str] = []
    assert list(read_records(MAGIC + rubbish, "x", damage.append)) == []
    assert damage


@given(st.binary(max_size=60), st.binary(max_size=60))
@settings(max_examples=40)
def test_rubbish_that_looks_like_a_chunk(before: bytes, after: bytes) -> None:
    data = MAGIC + b"\x06" + before + b"\x06" * 37 + b"\x04\x00\x00\x00zstd" + after
    assert list(read_records(data, "x", lambda _: None)) == []


def test_a_message_that_is_shorter_than_its_own_head_is_damage_and_takes_nothing_from_the_next() -> None:
    short, following = (struct.pack("<BQ", Opcode.MESSAGE, n) + bytes(n) for n in (10, 30))
    records = short + following
    body = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQII4sQ", 0, 0, len(records), zlib.crc32(records), 4, b"zstd", len(body))
    chunk = struct.pack("<BQ", Opcode.CHUNK, len(head) + len(body)) + head + body
    damage: list[str] = []
    assert list(read_records(MAGIC + chunk, "a.mcap", damage.append)) == []
    assert "ends in the middle of a record" in damage[0]
