"""A journal whose disk takes nothing for a while."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path

import pytest

from tests.unit.app.journals import HEADER, record, until
from visloc_companion.app import journal
from visloc_companion.app.journal import JournalWriter, read_header, read_journal
from visloc_companion.app.journal_stream import JournalStream


class Disk(io.FileIO):
    """A file on a disk with `room` bytes left, which takes part of what does not fit as Linux does."""

    room, fault = 10**9, errno.ENOSPC

    def write(self, data: object) -> int:
        part = memoryview(data)[: self.room]  # type: ignore[arg-type]
        if not part:
            raise OSError(self.fault, os.strerror(self.fault))
        self.room -= len(part)
        return super().write(part)


@pytest.fixture
def tried_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_TRY_AGAIN_S", 0.02)
    monkeypatch.setattr(journal, "_FLUSH_S", 0.02)


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_it_goes_on_once_there_is_room_and_tells_what_is_missing(tmp_path: Path, tried_often: None, fault: int) -> None:
    problems: list[str] = []
    path = tmp_path / "a.mcap"
    disk = Disk(path, "xb")
    writer = JournalWriter(disk, HEADER, on_problem=problems.append, path=path, goes_on=True)  # type: ignore[arg-type]
    record(writer, range(100))
    until(lambda: writer.written == 101 and not writer._pending_bytes)
    disk.fault, disk.room = fault, 200
    record(writer, range(100, 200))
    until(lambda: problems)
    assert writer.problem == problems[0] == f"journal stopped: {os.strerror(fault)}"
    record(writer, range(200, 300))
    disk.room = 10**9
    until(lambda: not writer.problem)
    record(writer, range(300, 400))
    writer.close()
    assert problems[1:] == [f"journal goes on: {writer.dropped} records missing"]
    damage: list[str] = []
    seen = [entry.now_ns for entry in read_journal(path, on_damage=damage.append)]
    assert seen[:100] == [*range(100)] and seen[-100:] == [*range(300, 400)]
    assert len(seen) == 400 - writer.dropped and writer.dropped >= 100
    assert len(damage) == 1 and "records are missing before number" in damage[0]
    assert read_header(path) == HEADER


def test_a_disk_that_stays_full_leaves_what_it_took_and_no_half_of_a_chunk(tmp_path: Path, tried_often: None) -> None:
    path = tmp_path / "a.mcap"
    disk = Disk(path, "xb")
    writer = JournalWriter(disk, HEADER, path=path, goes_on=True)  # type: ignore[arg-type]
    record(writer, range(100))
    until(lambda: writer.written == 101 and not writer._pending_bytes)
    size_bytes = path.stat().st_size
    disk.room = 200
    record(writer, range(100, 200))
    until(lambda: writer.problem)
    writer.close()
    assert path.stat().st_size == size_bytes
    assert [entry.now_ns for entry in read_journal(path)] == [*range(100)]


def test_what_does_not_fit_waits_and_is_taken_back(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "a", "xb")
    stream = JournalStream(disk)  # type: ignore[arg-type]
    stream.write(b"first")
    stream.flush()
    disk.room = 3
    stream.write(b"second")
    with pytest.raises(OSError, match="No space left"):
        stream.flush()
    assert ((tmp_path / "a").read_bytes(), stream.kept_bytes, stream.tell()) == (b"first", 5, 11)
    disk.room = 100
    stream.write(b"third")
    stream.flush()
    assert (tmp_path / "a").read_bytes() == b"firstsecondthird"
    disk.close()
