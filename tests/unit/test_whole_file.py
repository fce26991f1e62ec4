"""Small files are whole at any moment, and nothing stays beside them."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from visloc_companion.whole_file import is_stream, write_result, write_whole


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


WRITER = """
import sys
from pathlib import Path
from visloc_companion.whole_file import write_result
print("said before")
write_result(Path(sys.argv[1]), b"result\\n")
print("said after")
"""


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "link"])
def test_a_result_goes_where_standard_output_goes_and_takes_nothing_away(tmp_path: Path, name: str) -> None:
    """`--json /dev/stdout >> all.txt` replaced the file: what was in it was gone, and what was said after the result as well."""
    (tmp_path / "link").symlink_to("/dev/stdout")
    log = tmp_path / "all.txt"
    log.write_text("of the run before\n")
    with log.open("ab") as out:
        subprocess.run([sys.executable, "-c", WRITER, str(tmp_path / name)], stdout=out, check=True)
    assert log.read_text().splitlines() == ["of the run before", "said before", "result", "said after"]
    assert {path.name for path in tmp_path.iterdir()} == {"link", "all.txt"}


def test_a_result_goes_into_a_socket_that_is_standard_output() -> None:
    """As under systemd: /dev/stdout cannot be opened then."""
    here, there = socket.socketpair()
    with here, there:
        subprocess.run([sys.executable, "-c", WRITER, "/dev/stdout"], stdout=there, check=True)
        assert here.recv(1000, socket.MSG_WAITALL | socket.MSG_DONTWAIT).split(b"\n")[1] == b"result"


def test_what_takes_a_result_as_it_comes_is_told_from_files(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"")
    (tmp_path / "round").symlink_to("round")
    number = os.open(file, os.O_WRONLY)
    try:
        assert is_stream(Path(os.devnull)) and is_stream(Path(f"/dev/fd/{number}"))
        assert not any(is_stream(tmp_path / name) for name in ("file", "new", "round", "no/folder"))
    finally:
        os.close(number)


def test_nothing_is_written_beside_standard_output_that_is_a_file(tmp_path: Path) -> None:
    """Of `visloc sim --json /dev/stdout > out.json` the epochs went to /dev/stdout-epochs.csv, or the flight was in vain."""
    write = "import sys, pathlib; from visloc_companion.cli.sim_result import write_result; "
    write += "write_result(None, {'schema': 1}, pathlib.Path('/dev/stdout'))"
    with (tmp_path / "out.json").open("wb") as out:
        subprocess.run([sys.executable, "-c", write], stdout=out, check=True)
    assert json.loads((tmp_path / "out.json").read_text()) == {"schema": 1, "epochs": None}
