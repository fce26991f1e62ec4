"""What is deleted before a new journal begins, and what stays."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import pytest

from tests.unit.app.daemon import HOME, configuration, flight, hovering
from visloc_companion.app.handover import Handover
from visloc_companion.app.journal import JournalWriter, read_journal
from visloc_companion.app.journal_folder import delete_outgrown, outgrown
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.config import parse_config
from visloc_companion.doctor.collect.system import read_system
from visloc_companion.types import Injection, LinkChanged, Notice


@pytest.fixture(autouse=True)
def _answers_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def journals(folder: Path, *names: str, n_bytes: int = 100) -> list[Path]:
    """Files that were written one after the other."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for age, name in enumerate(reversed(names)):
        path = folder / name
        path.write_bytes(bytes(n_bytes))
        os.utime(path, ns=(0, 10**18 - age * 10**9))
        made.append(path)
    return made[::-1]


def test_the_oldest_go_until_the_rest_fits(tmp_path: Path) -> None:
    """By the last write, not by the name: a computer without a clock begins each day at the same date."""
    old, older_name, new = journals(tmp_path, "visloc-20260301T000000Z.mcap", "visloc-20260101T000000Z.mcap", "visloc-x.mcap")
    assert outgrown(tmp_path, 200) == {old: 100}
    assert outgrown(tmp_path, 199) == {old: 100, older_name: 100}
    assert delete_outgrown(tmp_path, 200) == [old]
    assert sorted(tmp_path.iterdir()) == sorted([older_name, new])


def test_the_flight_before_is_never_deleted(tmp_path: Path) -> None:
    old, last = journals(tmp_path, "visloc-1.mcap", "visloc-2.mcap")
    assert delete_outgrown(tmp_path, 1) == [old]
    assert delete_outgrown(tmp_path, 1) == []
    assert last.exists()


def test_nor_is_it_where_the_clock_went_back_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A companion without a battery knew the date at home and not in the field, and the flight in the field counted as oldest."""
    first, second = journals(tmp_path, "visloc-20261130T100000Z.mcap", "visloc-20261130T110000Z.mcap")
    monkeypatch.setattr(time, "time_ns", lambda: 10**17)
    assert delete_outgrown(tmp_path, 10**6) == []
    (field,) = journals(tmp_path, "visloc-19730303T094640Z.mcap")
    os.utime(field, ns=(0, 10**17 + 10**9))
    for now_ns in (10**17 + 10**12, 2 * 10**18):
        monkeypatch.setattr(time, "time_ns", lambda now_ns=now_ns: now_ns)
        assert list(outgrown(tmp_path, 1)) == [first, second]
    assert delete_outgrown(tmp_path, 1) == [first, second]


def test_all_are_kept_unless_the_configuration_says_otherwise(tmp_path: Path) -> None:
    made = journals(tmp_path, "visloc-1.mcap", "visloc-2.mcap")
    assert delete_outgrown(tmp_path, 0) == delete_outgrown(tmp_path, 200) == []
    assert all(path.exists() for path in made)


def test_what_bears_another_name_is_neither_counted_nor_deleted(tmp_path: Path) -> None:
    (kept,) = journals(tmp_path, "accident-visloc-1.mcap", n_bytes=5000)
    ours, _ = journals(tmp_path, "visloc-2.mcap", "visloc-3.mcap")
    assert outgrown(tmp_path, 200) == {}
    assert delete_outgrown(tmp_path, 150) == [ours]
    assert kept.exists()


def test_a_folder_that_is_not_there_or_a_file_that_stays_is_no_fault(tmp_path: Path) -> None:
    assert delete_outgrown(tmp_path / "none", 1) == []
    ours, _ = journals(tmp_path, "visloc-2.mcap", "visloc-3.mcap")
    (folder := tmp_path / "visloc-folder.mcap").mkdir()
    os.utime(folder, ns=(0, 0))
    assert delete_outgrown(tmp_path, 1) == [ours]
    assert folder.exists()


async def test_a_daemon_makes_room_before_it_records_and_says_so(tmp_path: Path) -> None:
    """Flights went unrecorded once the journals of those before had filled the card."""
    old, last = journals(tmp_path / "journals", "visloc-1.mcap", "visloc-2.mcap")
    async with flight(configuration(tmp_path, journal={"keep_bytes": 150})) as f, hovering(f):
        journal = f.daemon.parts.journal
        assert journal is not None
        assert journal.path is not None
        assert sorted((tmp_path / "journals").iterdir()) == sorted([last, journal.path])
        await f.until(lambda: journal.written > 20, "records")
    told = [entry.command for entry in read_journal(journal.path, shell=True) if isinstance(entry.command, Notice)]
    assert [notice.data for notice in told if "journal.keep_bytes" in notice.text] == [(("names", "visloc-1.mcap"),)]
    assert not old.exists()


async def test_a_start_in_flight_does_not_wait_for_that(tmp_path: Path) -> None:
    made = journals(tmp_path / "journals", "visloc-1.mcap", "visloc-2.mcap")
    socket = tmp_path / "status.sock"
    before = Handover(str(socket))
    before.heard(LinkChanged(0, True, system_id=1, armed=True))
    before.did(Injection(0, (0.0, 0.0, 0.0), HOME, (1.0, 0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)), 1.0, 0.02, 0))
    async with flight(configuration(tmp_path, journal={"keep_bytes": 150}, status={"socket": str(socket)})):
        assert all(path.exists() for path in made)


def test_the_doctor_counts_what_the_daemon_will_delete(tmp_path: Path) -> None:
    journals(tmp_path, "visloc-1.mcap", "visloc-2.mcap", n_bytes=50_000_000)
    kept, less = (
        read_system(parse_config({"journal": {"folder": str(tmp_path), "keep_bytes": keep}})).disk_free_mb for keep in (0, 10**7)
    )
    assert kept is not None
    assert less is not None
    assert less - kept == pytest.approx(50.0, abs=25.0), "other programs write meanwhile"


def test_a_full_disk_leaves_no_empty_journal_in_the_place_of_the_flight_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file can be made on it, and nothing be written: as the newest it stayed, and that of the flight before could go."""
    (last,) = journals(tmp_path, "visloc-20260101T000000Z.mcap")

    def full(descriptor: int) -> None:
        os.ftruncate(descriptor, 0)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("visloc_companion.app.journal.os.fsync", full)
    writer = JournalWriter.create(tmp_path, JournalHeader({}), max_bytes=50_000_000)
    writer.close()
    assert writer.problem
    assert list(tmp_path.iterdir()) == [last]
    assert delete_outgrown(tmp_path, 10) == []
