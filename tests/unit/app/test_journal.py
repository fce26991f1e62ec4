"""The flight record: complete, ordered, salvageable, and no danger to the flight."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader

from visloc_companion.app import journal
from visloc_companion.app.journal import (
    Entry,
    JournalHeader,
    JournalWriter,
    header_left,
    read_frames,
    read_header,
    read_journal,
    read_mavlink,
)
from visloc_companion.errors import JournalError
from visloc_companion.types import Attitude, Command, Event, FrameRef, Notice, RequestMessage, Severity, Tick

HEADER = JournalHeader({"seed": 3}, {"visloc": "0"}, "ab" * 32, started_ns=5, started_unix_ns=1_700_000_000_000_000_000)


def flight(n: int) -> list[Entry]:
    """Ticks and attitudes, and a command after every tenth."""
    entries: list[Entry] = []
    for i in range(n):
        t = 1000 + 10 * i
        event: Event = Tick(t) if i % 2 else Attitude(t, i, (1.0, 0.1 * i, 0.0, 1e-300), (0.1, -0.0, 1 / 3))
        entries.append(Entry(t, event, None))
        if i % 10 == 0:
            command: Command = Notice(Severity.INFO, f"notice {i}") if i % 20 else RequestMessage(30, 50.0)
            entries.append(Entry(t, None, command))
    return entries


def write(writer: JournalWriter, entries: list[Entry]) -> None:
    for entry in entries:
        writer.entry(entry)


class Slow(io.FileIO):
    """A file that takes nothing before its gate is open."""

    def __init__(self, path: Path, gate: threading.Event) -> None:
        super().__init__(path, "wb")
        self._gate = gate

    def write(self, data: object) -> int:
        self._gate.wait(30)
        return super().write(data)  # type: ignore[arg-type]


def recorded(folder: Path, entries: list[Entry]) -> Path:
    writer = JournalWriter.create(folder, HEADER, max_bytes=50_000_000)
    write(writer, entries)
    writer.close()
    assert writer.path is not None
    assert (writer.dropped, writer.problem) == (0, "")
    return writer.path


def test_what_is_written_is_read_in_order(tmp_path: Path) -> None:
    entries = flight(500)
    path = recorded(tmp_path / "new" / "folder", entries)
    damage: list[str] = []
    assert list(read_journal(path, on_damage=damage.append)) == entries
    assert damage == []
    assert list(read_journal(path, salvage=False)) == entries
    assert list(read_journal(path, commands=False)) == [entry for entry in entries if entry.event is not None]
    assert read_header(path) == HEADER
    assert path.name == "visloc-20231114T221320Z.mcap"


def test_journals_of_one_second_get_names_of_their_own(tmp_path: Path) -> None:
    assert len({recorded(tmp_path, flight(3)) for _ in range(3)}) == 3


def test_the_library_and_other_tools_can_read_it(tmp_path: Path) -> None:
    path = recorded(tmp_path, flight(50))
    with path.open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    assert messages[0][1].topic == "/header"
    topics = {channel.topic for _, channel, _ in messages}
    assert topics == {"/header", "/event/Tick", "/event/Attitude", "/command/Notice", "/command/RequestMessage"}
    schema = next(schema for schema, channel, _ in messages if channel.topic == "/event/Tick")
    assert schema is not None
    assert json.loads(schema.data)["title"] == "Tick"


def test_raw_bytes_and_the_shells_notices_are_kept_apart_from_the_replay(tmp_path: Path) -> None:
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10_000_000)
    writer.mavlink(1, b"\xfd\x00\xff", outgoing=False)
    writer.mavlink(2, b"\xfd\x01", outgoing=True)
    writer.notice(3, Notice(Severity.WARNING, "worker died"))
    writer.event(4, Tick(4))
    writer.close()
    assert writer.path is not None
    assert list(read_mavlink(writer.path, outgoing=False)) == [(1, b"\xfd\x00\xff")]
    assert list(read_mavlink(writer.path, outgoing=True)) == [(2, b"\xfd\x01")]
    assert list(read_journal(writer.path)) == [Entry(4, Tick(4), None)]
    with_the_shell = list(read_journal(writer.path, shell=True))
    assert with_the_shell == [Entry(3, None, Notice(Severity.WARNING, "worker died")), Entry(4, Tick(4), None)]


@pytest.mark.parametrize("shape", [(6, 8), (6, 8, 3)])
def test_frames_come_back_pixel_for_pixel(tmp_path: Path, shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10_000_000)
    kept = pixels.copy()
    writer.frame(7, FrameRef(7, 6, 41, 0, 8, 6, 3 if pixels.ndim == 3 else 1), pixels)
    pixels[:] = 0  # the slot is overwritten while the thread still encodes
    writer.close()
    assert writer.path is not None
    ((frame_id, back),) = read_frames(writer.path)
    assert frame_id == 41
    np.testing.assert_array_equal(back, kept)


def test_frames_give_way_when_the_disk_is_slow(tmp_path: Path) -> None:
    gate = threading.Event()
    writer = JournalWriter(Slow(tmp_path / "slow.mcap", gate), HEADER)  # type: ignore[arg-type]
    for i in range(10):
        writer.frame(i, FrameRef(i, i, i, 0, 8, 6, 1), np.zeros((6, 8), np.uint8))
        writer.event(i, Tick(i))
    gate.set()
    writer.close()
    assert (writer.dropped, writer.written) == (6, 1 + 4 + 10)


def test_a_full_queue_drops_counts_and_the_reader_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_QUEUE", 20)
    gate, path = threading.Event(), tmp_path / "slow.mcap"
    writer = JournalWriter(Slow(path, gate), HEADER)  # type: ignore[arg-type]
    write(writer, flight(100))
    gate.set()
    while writer._queue.qsize():
        pass
    writer.event(9999, Tick(9999))
    writer.close()
    assert writer.dropped > 0
    damage: list[str] = []
    entries = list(read_journal(path, on_damage=damage.append))
    assert entries[-1] == Entry(9999, Tick(9999), None)
    assert len(entries) + writer.dropped == len(flight(100)) + 1
    assert damage == [f"{writer.dropped} records are missing before number {len(flight(100)) + 2}"]


def test_frames_are_recorded_again_after_the_queue_was_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_QUEUE", 3)
    gate, path = threading.Event(), tmp_path / "slow.mcap"
    writer = JournalWriter(Slow(path, gate), HEADER)  # type: ignore[arg-type]
    pixels = np.zeros((6, 8), np.uint8)
    write(writer, flight(9))
    for i in range(6):
        writer.frame(i, FrameRef(i, i, i, 0, 8, 6, 1), pixels)
    gate.set()
    writer.wait(0)
    writer.frame(77, FrameRef(77, 77, 77, 0, 8, 6, 1), pixels)
    writer.close()
    assert [frame_id for frame_id, _ in read_frames(path)] == [77]


def test_a_disk_that_hangs_does_not_keep_the_daemon_from_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_QUEUE", 5)
    monkeypatch.setattr(journal, "_CLOSE_S", 0.05)
    gate = threading.Event()

    class Hung(io.BytesIO):
        def write(self, data: object) -> int:
            gate.wait(30)
            return super().write(data)  # type: ignore[arg-type]

    writer = JournalWriter(Hung(), HEADER)
    write(writer, flight(100))
    writer.close()
    assert writer._thread.is_alive()  # it was not waited for
    gate.set()
    writer._thread.join()
    assert "closed file" in writer.problem


def test_a_record_that_cannot_be_written_costs_only_itself(tmp_path: Path) -> None:
    problems: list[str] = []
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10_000_000, on_problem=problems.append)
    writer.event(1, Tick(1))
    writer.event(2, Tick("noon"))  # type: ignore[arg-type]
    writer.event(-3, Tick(3))
    writer.event(4, Tick(4))
    writer.close()
    assert writer.path is not None
    assert writer.dropped == 2
    assert len(problems) == 1
    assert "record dropped" in problems[0]
    assert [entry.event for entry in read_journal(writer.path)] == [Tick(1), Tick(4)]


def test_a_picture_that_cannot_be_encoded_costs_only_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problems: list[str] = []
    encode, calls = cv2.imencode, list[int]()

    def scarce(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) <= 2 * journal._FRAMES_QUEUED:
            raise MemoryError
        return encode(*arguments)

    monkeypatch.setattr(cv2, "imencode", scarce)
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10_000_000, on_problem=problems.append)
    for n in range(2 * journal._FRAMES_QUEUED + 1):
        writer.frame(n, FrameRef(n, n, n, 0, 8, 6, 1), np.full((6, 8), n, np.uint8))
        writer.wait(0)
    writer.close()
    assert writer.path is not None
    assert [number for number, _ in read_frames(writer.path)] == [2 * journal._FRAMES_QUEUED]
    assert (writer.dropped, writer.problem) == (2 * journal._FRAMES_QUEUED, "")
    assert len(problems) == 1 and "MemoryError" in problems[0]


def test_whatever_ends_the_journal_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problems: list[str] = []
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10_000_000, on_problem=problems.append)

    def fails() -> None:
        raise zstandard.ZstdError("cannot compress: Allocation error: not enough memory")

    monkeypatch.setattr(writer._writer, "flush", fails)
    writer.event(1, Tick(1))
    writer.close()
    assert problems == [writer.problem] == ["journal stopped: cannot compress: Allocation error: not enough memory"]


def test_a_full_disk_ends_the_journal_with_one_report(tmp_path: Path) -> None:
    problems: list[str] = []
    writer = JournalWriter(Path("/dev/full").open("wb"), HEADER, on_problem=problems.append)  # noqa: SIM115
    write(writer, flight(200))
    writer._thread.join(30)
    write(writer, flight(200))
    writer.close()
    assert problems == ["journal stopped: No space left on device"]
    assert writer.problem == problems[0]
    assert writer.dropped >= len(flight(200))


def test_the_journal_ends_whole_at_its_largest_size(tmp_path: Path) -> None:
    problems: list[str] = []
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=1_000_000, on_problem=problems.append)
    noise = np.random.default_rng(2)
    entries = [Entry(i, Attitude(i, i, tuple(noise.normal(size=4)), tuple(noise.normal(size=3))), None) for i in range(20_000)]
    for start in range(0, len(entries), 2000):
        write(writer, entries[start : start + 2000])
        while writer._queue.qsize():
            pass
    writer.close()
    assert writer.path is not None
    assert problems == ["journal stopped: it reached journal.max_bytes = 1000000"]
    assert 500_000 < writer.path.stat().st_size <= 1_000_000
    kept = list(read_journal(writer.path, salvage=False))
    assert kept == entries[: len(kept)]
    assert len(kept) > 4000


@pytest.mark.parametrize("folder", ["/proc/visloc", "/dev/null/x"])
def test_a_folder_that_cannot_be_written_is_an_error_at_the_start(folder: str) -> None:
    with pytest.raises(JournalError, match=r"cannot be written.*remedy: name a writable journal\.folder"):
        JournalWriter.create(Path(folder), HEADER, max_bytes=1_000_000)


KILLED = """
import sys, time
from pathlib import Path
from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.types import Tick
writer = JournalWriter.create(Path(sys.argv[1]), JournalHeader({"seed": 4}), max_bytes=10**7)
n = 0
while True:
    writer.event(n, Tick(n))
    n += 1
    if n == 500:
        while writer._queue.qsize() or writer._pending_bytes:
            time.sleep(0.05)
        sys.stdout.write("flushed\\n"); sys.stdout.flush()
    time.sleep(0.0005)
"""


def test_a_killed_writer_costs_at_most_the_last_chunk(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"flushed\n"
        process.send_signal(signal.SIGKILL)
    (path,) = tmp_path.glob("*.mcap")
    damage: list[str] = []
    entries = list(read_journal(path, on_damage=damage.append))
    assert len(entries) >= 500
    assert [entry.event for entry in entries] == [Tick(n) for n in range(len(entries))]
    assert len(damage) == 1
    assert "the writer was killed" in damage[0]
    assert read_header(path).configuration == {"seed": 4}
    with pytest.raises(JournalError, match=r"is damaged: .*remedy: .*visloc replay FILE --salvage"):
        list(read_journal(path, salvage=False))


@pytest.mark.parametrize(
    ("content", "what"), [(b"", "is empty"), (b"PK\x03\x04" * 9, "is not a journal"), (b"\x89MC", "is not a journal")]
)
def test_a_file_that_is_no_journal(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(JournalError, match=what):
        list(read_journal(path))
    with pytest.raises(JournalError, match=what):
        read_header(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="cannot be read"):
        list(read_journal(tmp_path / "none.mcap"))


def test_a_journal_cut_before_its_header(tmp_path: Path) -> None:
    path = recorded(tmp_path, flight(3))
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(JournalError, match="holds no header"):
        read_header(path)


def test_what_follows_a_damaged_first_chunk_is_left(tmp_path: Path) -> None:
    """With it go the header and the names of the channels that were described there."""
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=50_000_000)
    pixels = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
    for k in range(2):
        writer.event(1 + k, Tick(1 + k))
        writer.frame(1 + k, FrameRef(1, 1, k, 0, 16, 12, 3), pixels)
        writer.wait(0)
        time.sleep(0.1 if k else 1.2)  # what comes later lies in a chunk of its own
    writer.close()
    assert writer.path is not None
    data = bytearray(writer.path.read_bytes())
    at, chunks = 8, []
    while data[at] != Opcode.DATA_END:
        chunks += [at] if data[at] == Opcode.CHUNK else []
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    assert len(chunks) == 3
    for at in chunks[:2]:
        data[at + 60] ^= 1
    writer.path.write_bytes(data)
    assert [entry.event for entry in read_journal(writer.path)] == [Tick(2)]
    assert [number for number, _ in read_frames(writer.path)] == [1]
    assert header_left(writer.path) == JournalHeader({})
    writer.path.write_bytes(data[:40])
    with pytest.raises(JournalError, match="holds no header"):
        header_left(writer.path)
