"""MCAP files that other programs wrote: a journal anew, or what is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter, header_left, read_header, read_journal
from visloc_companion.errors import JournalError
from visloc_companion.types import Attitude, Tick

HEADER = JournalHeader({"seed": 3}, {"visloc": "0"}, "ab" * 32, started_ns=5, started_unix_ns=1_700_000_000_000_000_000)
ENTRIES = [Entry(t, Tick(t) if t % 2 else Attitude(t, t, (1.0, 0.0, 0.0, 0.0), (0.1, -0.0, 1 / 3)), None) for t in range(9, 300)]


def mcap_file(path: Path, messages: list[tuple[str, int, int, bytes]], compression: CompressionType) -> Path:
    """Another program's file with these (topic, sequence, time, bytes)."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, index_types=IndexType.NONE)
        writer.start(profile="ros2")
        channels = {topic: writer.register_channel(topic, "cdr", 0) for topic in sorted({topic for topic, *_ in messages})}
        for topic, sequence, t_ns, data in messages:
            writer.add_message(channels[topic], t_ns, data, t_ns, sequence)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", CompressionType)
def test_a_journal_that_another_tool_wrote_anew_is_the_same(tmp_path: Path, compression: CompressionType) -> None:
    writer = JournalWriter.create(tmp_path, HEADER, max_bytes=10**8)
    for entry in ENTRIES:
        writer.entry(entry)
    writer.close()
    assert writer.path is not None
    with writer.path.open("rb") as stream:
        messages = [(c.topic, m.sequence, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
    anew = mcap_file(tmp_path / "anew.mcap", sorted(messages, key=lambda one: one[1]), compression)
    assert read_header(anew) == HEADER
    assert list(read_journal(anew, salvage=False)) == ENTRIES


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("read", [read_header, header_left])
def test_a_robots_recording_is_told_from_a_journal(
    tmp_path: Path, compression: CompressionType, read: Callable[[Path], Any]
) -> None:
    robots = mcap_file(tmp_path / "ros.mcap", [("/fix", 0, 1, b"\0" * 90), ("/imu", 0, 2, b"\1" * 90)], compression)
    with pytest.raises(JournalError, match="of another program: it holds the topic /fix and 1 more"):
        read(robots)
