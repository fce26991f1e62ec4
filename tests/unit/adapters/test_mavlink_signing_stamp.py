"""The time of signing from one start to the next."""

import errno
import os
import threading
import time
from pathlib import Path

import pytest

from visloc_companion.adapters.mavlink import signing_stamp
from visloc_companion.adapters.mavlink.signing import KEEP_EVERY_NS, SigningTime
from visloc_companion.adapters.mavlink.signing_stamp import MARGIN, StampFile
from visloc_companion.errors import ConfigError
from visloc_companion.whole_file import write_whole


def written() -> None:
    """Wait for the last stamp that was to be kept."""
    for thread in threading.enumerate():
        if thread.name == "signing stamp":
            thread.join(30)


def test_a_start_begins_a_minute_past_what_was_kept(tmp_path: Path) -> None:
    told: list[str] = []
    file = StampFile(tmp_path / "stamp", told.append)
    assert file.first() == 0
    file.keep(123456)
    written()
    assert StampFile(tmp_path / "stamp", told.append).first() == 123456 + MARGIN
    assert [path.name for path in tmp_path.iterdir()] == ["stamp"]
    assert told == []


@pytest.mark.parametrize("content", [b"", b"\n", b"-5", b"12.5", b"\xff\xfe", b"9" * 400, "²".encode()])
def test_a_file_that_a_power_cut_left_is_as_none(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "stamp"
    path.write_bytes(content)
    assert StampFile(path, lambda _: None).first() == 0


def test_it_is_kept_at_once_and_every_half_minute() -> None:
    kept: list[int] = []
    signing = SigningTime(1000, kept.append)
    for now_ns in range(5, 2 * KEEP_EVERY_NS, KEEP_EVERY_NS // 10):
        signing.advance(now_ns)
    assert kept == [1000, 1000 + KEEP_EVERY_NS // 10_000]


def test_a_place_that_cannot_be_written_stands_against_the_start(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"link.signing_stamp_file.*cannot be written.*remedy"):
        StampFile(tmp_path / "absent" / "stamp", lambda _: None)


@pytest.mark.parametrize("fault", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_is_told_and_does_not_stand_against_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int
) -> None:
    (tmp_path / "stamp").write_text("123456")

    def fails(*_: object, **__: object) -> None:
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr(Path, "touch", fails)
    monkeypatch.setattr(signing_stamp, "write_whole", fails)
    told: list[str] = []
    file = StampFile(tmp_path / "stamp", told.append)
    file.keep(200000)
    written()
    file.keep(300000)
    written()
    assert file.first() == 123456 + MARGIN
    assert told == [f"the time of signing cannot be kept in {tmp_path / 'stamp'}: {os.strerror(fault)}"]


def test_a_disk_that_fails_later_is_told_once(tmp_path: Path) -> None:
    told: list[str] = []
    folder = tmp_path / "folder"
    folder.mkdir()
    file = StampFile(folder / "stamp", told.append)
    (folder / "stamp").unlink()
    folder.rmdir()
    for stamp in range(3):
        file.keep(stamp)
        written()
    assert len(told) == 1


def test_a_card_that_is_slow_holds_nothing_up_and_is_not_written_to_twice_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one who signs is the one who sends positions: PX4 gives vision up after 0.4 s without."""
    contents, go_on = list[bytes](), threading.Event()

    def slow(path: Path, content: bytes) -> None:
        contents.append(content)
        assert go_on.wait(30)
        write_whole(path, content)

    monkeypatch.setattr(signing_stamp, "write_whole", slow)
    file = StampFile(tmp_path / "stamp", lambda _: None)
    threading.Timer(2.0, go_on.set).start()
    begun_s = time.monotonic()
    for stamp in range(1, 4):
        file.keep(stamp)
    assert time.monotonic() - begun_s < 1.0
    written()
    assert contents == [b"1\n"]
    assert file.first() == 1 + MARGIN
