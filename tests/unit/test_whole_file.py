"""Small files are whole at any moment, and nothing stays beside them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from visloc_companion.whole_file import write_whole


@pytest.mark.parametrize("synced", [False, True])
def test_a_file_is_replaced_and_its_draft_is_gone(tmp_path: Path, synced: bool) -> None:
    path = tmp_path / "stamp"
    for content in (b"one", b"", b"two\n"):
        write_whole(path, content, synced=synced)
        assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_replaced_stays_and_no_draft_is_left(tmp_path: Path) -> None:
    folder = tmp_path / "name"
    folder.mkdir()
    with pytest.raises(OSError):
        write_whole(folder, b"data")
    assert list(tmp_path.iterdir()) == [folder]


def test_only_what_must_outlast_a_loss_of_power_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[bytes] = []
    monkeypatch.setattr(os, "fsync", lambda _: synced.append((tmp_path / ".a.part").read_bytes()))
    write_whole(tmp_path / "a", b"in flight")
    write_whole(tmp_path / "a", b"hours of work", synced=True)
    assert synced == [b"hours of work"], "all of it, and before the file has its name"
