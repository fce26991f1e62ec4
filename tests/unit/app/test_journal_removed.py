"""A journal whose file, or folder, is removed or renamed while it is written."""

from __future__ import annotations

import errno
import os
import shutil
import time
from pathlib import Path

import pytest

from tests.unit.app.journals import HEADER, record, until
from visloc_companion.app import journal, journal_lock, journal_removed
from visloc_companion.app.journal import JournalWriter, read_header, read_journal

ANEW = "journal was removed, is made anew"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_FLUSH_S", 0.02)
    monkeypatch.setattr(journal_removed, "_TRY_AGAIN_S", 0.02)


class Flown:
    """A journal of a flight: what its writer reported, and its file."""

    def __init__(self, folder: Path) -> None:
        self.problems: list[str] = []
        self.writer = JournalWriter.create(folder, HEADER, max_bytes=10_000_000, on_problem=self.problems.append)
        assert self.writer.path is not None
        self.path = self.writer.path
        self.record(0, 100)

    def record(self, first_ns: int, after_ns: int) -> None:
        """Record ticks, and wait until the file has them."""
        record(self.writer, range(first_ns, after_ns))
        until(lambda: self.writer.written == after_ns + 1 and not self.writer._pending_bytes)

    def whole(self, n: int) -> bool:
        """Whether the file holds all ticks, without a gap, and its header."""
        damage: list[str] = []
        seen = [entry.now_ns for entry in read_journal(self.path, on_damage=damage.append)]
        return seen == [*range(n)] and not damage and read_header(self.path) == HEADER and not self.writer.dropped


@pytest.mark.parametrize("what", ["file", "folder"])
def test_one_that_is_removed_is_made_anew_with_all_that_was_in_it(tmp_path: Path, what: str) -> None:
    flown = Flown(tmp_path / "journals")
    flown.path.unlink() if what == "file" else shutil.rmtree(flown.path.parent)
    until(lambda: flown.problems)
    assert flown.problems == [ANEW]
    until(flown.path.exists)
    flown.record(100, 200)
    until(lambda: flown.path.exists() and flown.path.stat().st_size == flown.writer._written.kept_bytes)
    with flown.path.open("rb") as file:
        assert journal_lock.is_held(file), "it is being written"
    flown.record(200, 300)
    flown.writer.close()
    assert flown.whole(300) and flown.problems == [ANEW] and not flown.writer.problem


def test_it_is_whole_where_the_flight_ends_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_removed, "COPIED_AT_ONCE", 10)
    flown = Flown(tmp_path / "journals")
    flown.path.unlink()
    until(lambda: flown.problems)
    flown.writer.close()
    assert flown.whole(100)


def test_a_large_one_is_made_anew_little_by_little_beside_the_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And twice where it is removed again, while it is copied and after."""
    monkeypatch.setattr(journal_removed, "COPIED_AT_ONCE", 500)
    flown, n = Flown(tmp_path / "journals"), 100
    for _ in range(2):
        flown.path.unlink()
        until(lambda: flown.path.exists() and flown.path.stat().st_size >= 500)
        flown.path.unlink()
        until(lambda: flown.path.exists() and flown.path.stat().st_size >= 500)
        flown.record(n, n + 100)
        n += 100
        until(lambda: flown.writer._anew._copy is None and flown.path.exists())
    flown.record(n, n + 100)
    flown.writer.close()
    assert flown.whole(n + 100)


def test_one_that_cannot_be_made_anew_is_tried_again_and_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown, place = Flown(tmp_path / "journals"), Path.open

    def full(path: Path, *args: object, **more: object) -> object:
        if path == flown.path:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return place(path, *args, **more)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", full)
    flown.path.unlink()
    until(lambda: flown.problems)
    flown.record(100, 200)
    assert flown.problems == ["journal removed, not made anew: No space left on device"]
    monkeypatch.setattr(Path, "open", place)
    until(flown.path.exists)
    flown.record(200, 300)
    flown.writer.close()
    assert flown.whole(300) and flown.problems[1:] == [ANEW]


def test_a_part_of_one_is_not_left_where_the_disk_fills(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = Flown(tmp_path / "journals")

    def fails(*_: object) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "pread", fails)
    flown.path.unlink()
    until(lambda: len(flown.problems) == 2)
    time.sleep(0.2)
    flown.writer.close()
    assert not flown.path.exists()
    assert flown.problems == [ANEW, "journal removed, not made anew: Input/output error"], "once, however often it is tried"


def test_one_that_is_renamed_is_written_on_under_its_new_name(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "journals")
    flown.path = flown.path.rename(tmp_path / "kept.mcap")
    flown.record(100, 200)
    flown.writer.close()
    assert flown.whole(200) and not flown.problems
    assert not list((tmp_path / "journals").iterdir())
