"""Two journals in one file (cat a.mcap b.mcap): boots of their own, of which the first is read and the second is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, read_header, read_journal
from visloc_companion.errors import JournalError
from visloc_companion.types import Tick


def recorded(folder: Path, name: str, n: int, start_ns: int) -> bytes:
    writer = JournalWriter.create(folder / name, JournalHeader({"name": name}), max_bytes=50_000_000)
    for k in range(n):
        writer.entry(Entry(start_ns + k, Tick(start_ns + k), None))
    writer.close()
    assert writer.path is not None
    return writer.path.read_bytes()


@pytest.mark.parametrize("cut", [0, 1, 8, 30, 100, 150, 200, 250, 300])
def test_the_first_is_read_and_the_second_told(tmp_path: Path, cut: int) -> None:
    """Also where the first lost its end: its last flush, then, may be gone, and nothing of the second's times comes in."""
    first, second = recorded(tmp_path, "a", 50, 10**9), recorded(tmp_path, "b", 70, 5)
    kept = first[: len(first) - cut]
    path = tmp_path / "joined.mcap"
    path.write_bytes(kept + second)
    damages: list[str] = []
    entries = list(read_journal(path, on_damage=damages.append))
    assert [entry.now_ns for entry in entries] == [10**9 + k for k in range(50)]
    assert read_header(path).configuration == {"name": "a"}
    at = len(kept)
    assert f"another journal begins at byte {at} and is not read (tail -c +{at + 1} " in damages[-1]
    with pytest.raises(JournalError, match=r"is damaged: .*remedy: "):
        list(read_journal(path, salvage=False))
    (tmp_path / "second.mcap").write_bytes(path.read_bytes()[at:])
    assert len(list(read_journal(tmp_path / "second.mcap", salvage=False))) == 70
