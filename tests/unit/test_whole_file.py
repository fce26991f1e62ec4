"""Small files are whole at any moment, and nothing stays beside them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from visloc_companion.whole_file import write_result, write_whole


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


def full(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes no more of what is written from now on."""

    def refused(_: int) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(os, "fsync", refused)


def test_a_result_that_cannot_be_written_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "report.html"
    write_result(path, b"old")
    full(path, monkeypatch)
    with pytest.raises(OSError, match="No space"):
        write_result(path, b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_a_result_may_be_a_link_a_device_or_alone_in_being_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there, link = tmp_path / "there", tmp_path / "link"
    link.symlink_to(there)
    write_result(link, b"new")
    assert link.is_symlink() and there.read_bytes() == b"new"
    write_result(Path(os.devnull), b"gone")
    assert not Path(os.devnull).is_file()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    full(there, monkeypatch)
    write_result(there, b"newer")
    assert there.read_bytes() == b"newer"
