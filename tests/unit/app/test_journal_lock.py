"""A journal that is being written is told from one that was cut off."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from visloc_companion.app import journal_lock
from visloc_companion.app.journal import JournalWriter, read_journal
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.errors import JournalError
from visloc_companion.types import Tick

KILLED = """
import os, signal, sys, time
from pathlib import Path
from visloc_companion.app.journal import JournalWriter
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.types import Tick
writer = JournalWriter.create(Path(sys.argv[1]), JournalHeader({}), max_bytes=50_000_000)
writer.event(1, Tick(1))
time.sleep(1.5)
os.kill(os.getpid(), signal.SIGKILL)
"""


def begun(folder: Path) -> tuple[JournalWriter, Path]:
    """A journal with an event on the disk, whose writer goes on."""
    writer = JournalWriter.create(folder, JournalHeader({}), max_bytes=50_000_000)
    writer.event(1, Tick(1))
    writer.wait(0)
    assert writer.path is not None
    deadline_s = time.monotonic() + 30.0
    while not list(read_journal(writer.path)):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    return writer, writer.path


def told(path: Path) -> list[str]:
    damage: list[str] = []
    assert [entry.event for entry in read_journal(path, on_damage=damage.append)] == [Tick(1)]
    return damage


def test_a_journal_that_is_being_written_is_not_one_whose_writer_was_killed(tmp_path: Path) -> None:
    writer, path = begun(tmp_path)
    (damage,) = told(path)
    assert damage.endswith("(it is being written)")
    with pytest.raises(JournalError, match=r"is not whole: .*it is being written.*remedy: wait for its end, or .*--salvage"):
        list(read_journal(path, salvage=False))
    copied = Path(shutil.copy(path, tmp_path / "copied.mcap"))
    (damage,) = told(copied)
    assert damage.endswith("(the writer was killed)"), "nobody writes to what was copied amid the flight"
    writer.close()
    assert told(path) == []


def test_a_writer_that_was_killed_holds_nothing_and_nor_do_those_who_ask(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    (path,) = tmp_path.glob("*.mcap")
    with path.open("rb") as another:
        assert not journal_lock.is_held(another)
        (damage,) = told(path)
    assert damage.endswith("(the writer was killed)")
