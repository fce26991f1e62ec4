"""The flight record: every event and command with its time, raw MAVLink, and if wished the frames, in one MCAP file.

The first record is the effective configuration with versions and the map's hash. Topics: `/header`, `/event/TYPE`,
`/command/TYPE`, `/shell/Notice` (what the shell itself reports), `/mavlink/in`, `/mavlink/out` (bytes as they came),
`/camera/png` (frame number as little-endian uint64, then a PNG). The sequence number counts all records of all topics, so a
gap tells that records were dropped.

A thread writes, so a slow disk never holds the event loop. Chunks are at most 256 kB and are flushed to the disk every
second. A disk that is full, fails or became read-only is told, and tried again: the journal goes on once it takes what waits. A
file that is removed is made anew (journal_removed.py).
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import queue
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from mcap.writer import CompressionType, Writer

from visloc_companion.app import journal_lock
from visloc_companion.app.journal_end import abandon
from visloc_companion.app.journal_header import JournalHeader, OtherProgramsError, header_of, require_own
from visloc_companion.app.journal_payload import BINARY, FRAME, HEADER, MAVLINK_IN, MAVLINK_OUT, NOTICE, parsed, payload, thing_of
from visloc_companion.app.journal_records import records
from visloc_companion.app.journal_removed import MadeAnew, require_there
from visloc_companion.app.journal_stream import JournalStream
from visloc_companion.app.salvage import OnDamage
from visloc_companion.app.serialise import COMMAND_TYPES, EVENT_TYPES, json_schema
from visloc_companion.errors import JournalError, fault_text, is_of_the_disk
from visloc_companion.types import Command, Event, FrameRef, Image, Notice

CHUNK_BYTES = 240 * 1024
_FLUSH_S = 1.0
_CLOSE_S = 10.0
_TRY_AGAIN_S = 5.0
_QUEUE = 8192
_FRAMES_QUEUED = 4
_MESSAGE_OVERHEAD_BYTES = 56
_SUMMARY_BYTES, _SUMMARY_CHUNK_BYTES = 131_072, 640
"""Space kept for the summary at the end of the file: channels and schemas, and the index of a chunk."""
_PNG = b"\x89PNG\r\n\x1a\n"
"""Tells a frame whose channel was described in a chunk that was lost."""
_OF_TYPES = ("/event/", "/command/")


@dataclass(frozen=True, slots=True)
class Entry:
    """What the navigator was given (`event`) or answered (`command`; it follows its event) at a time. One of both is None."""

    now_ns: int
    event: Event | None
    command: Command | None


# --------------------------------------------------------------------------------------------------------------- reading


def read_journal(
    path: Path, salvage: bool = True, on_damage: OnDamage | None = None, *, commands: bool = True, shell: bool = False
) -> Iterator[Entry]:
    """Events and commands in the order in which they happened.

    With `salvage`, damaged parts are left out and told to `on_damage`, as are gaps in the numbering; without, they raise.
    Without `commands` these are passed over unread: a replay gives its own. With `shell` the shell's own notices come among the
    commands. Raises JournalError for a file that is no journal.
    """
    topics: tuple[str, ...] = _OF_TYPES if commands else _OF_TYPES[:1]
    topics = (*topics, NOTICE) if shell else topics
    expected: int | None = None
    for record in records(path, salvage, on_damage):
        if expected is not None and record.sequence != expected and on_damage is not None:
            on_damage(f"{(record.sequence - expected) % 2**32} records are missing before number {record.sequence}")
        expected = (record.sequence + 1) % 2**32
        if record.topic is None or record.topic.startswith(topics):
            data = parsed(record, path)
            name = data.get("type") if isinstance(data, dict) else None
            if record.topic is None and name not in EVENT_TYPES and name not in COMMAND_TYPES:
                continue  # the chunk that described this channel was lost, and what is in it is no event
            thing = thing_of(data, record, path)
            yield Entry(record.log_time_ns, *((thing, None) if name in EVENT_TYPES else (None, thing)))


def read_header(path: Path) -> JournalHeader:
    """The first record. Raises JournalError where there is none."""
    topics: set[str | None] = set()
    for record in records(path, True, None):
        if record.topic == HEADER:
            return header_of(parsed(record, path), path)
        topics.add(record.topic)
    require_own(topics, path)
    remedy = "it was cut in its first second, or damaged there: give the flight's configuration with --salvage --config FILE"
    raise JournalError("holds no header", where=str(path), remedy=remedy)


def header_left(path: Path) -> JournalHeader:
    """The first record, or one that says nothing where damage took it. Raises JournalError where nothing at all is left."""
    try:
        return read_header(path)
    except OtherProgramsError:
        raise
    except JournalError:
        if next(records(path, True, None), None) is None:
            raise
        return JournalHeader({})


def read_mavlink(path: Path, *, outgoing: bool) -> Iterator[tuple[int, bytes]]:
    """Raw bytes of the link with their times."""
    topic = MAVLINK_OUT if outgoing else MAVLINK_IN
    return ((record.log_time_ns, record.data) for record in records(path, True, None) if record.topic == topic)


def read_frames(path: Path) -> Iterator[tuple[int, Image]]:
    """Frame numbers and pixels, where frames were recorded. Raises JournalError for an image that cannot be decoded."""
    import cv2

    for record in records(path, True, None):
        if record.topic == FRAME or (record.topic is None and record.data[8 : 8 + len(_PNG)] == _PNG):
            pixels = cv2.imdecode(np.frombuffer(record.data, np.uint8, offset=8), cv2.IMREAD_UNCHANGED)
            if pixels is None:
                raise JournalError(f"the frame of record {record.sequence} cannot be decoded", where=str(path))
            rgb = pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[:, :, ::-1])
            yield struct.unpack_from("<Q", record.data)[0], np.asarray(rgb, dtype=np.uint8)


# --------------------------------------------------------------------------------------------------------------- writing


class JournalWriter:
    """Writes a journal from a thread of its own. No method but `wait` and `close` blocks or raises."""

    def __init__(
        self,
        stream: BinaryIO,
        header: JournalHeader,
        *,
        max_bytes: int = 2_000_000_000,
        on_problem: Callable[[str], None] | None = None,
        path: Path | None = None,
        goes_on: bool = False,
    ) -> None:
        """`on_problem` is called from the writing thread: when the journal ends before the flight does, and before that for the
        first record that cannot be written. `goes_on`: a disk that took something before is tried again."""
        self.path = path
        self.dropped = self.written = 0
        self.problem = ""
        self._stream, self._max_bytes, self._on_problem, self._goes_on = stream, max_bytes, on_problem, goes_on
        self._written = JournalStream(stream)
        self._anew = MadeAnew(path, self._report)
        self._sequence = self._frames_waiting = self._pending_bytes = self._chunks = 0
        self._drop_told = False
        self._queue: queue.Queue[tuple[str, int, int, Any] | None] = queue.Queue(_QUEUE)
        self._channels: dict[str, int] = {}
        journal_lock.hold(stream)
        self._writer = Writer(cast(Any, self._written), chunk_size=2**30, compression=CompressionType.ZSTD)
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
        self._put(HEADER, header.started_ns, header)
        self._thread.start()

    @classmethod
    def create(
        cls, folder: Path, header: JournalHeader, *, max_bytes: int, on_problem: Callable[[str], None] | None = None
    ) -> JournalWriter:
        """A new file named by date and time. Raises JournalError where none can be made in the folder."""
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(header.started_unix_ns / 1e9))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in (f"visloc-{stamp}.mcap", *(f"visloc-{stamp}-{n}.mcap" for n in range(1, 1000))):
                with contextlib.suppress(FileExistsError):
                    path = folder / name
                    return cls(path.open("x+b"), header, max_bytes=max_bytes, on_problem=on_problem, path=path, goes_on=True)
        except OSError as why:
            raise JournalError(f"cannot be written: {why}", where=str(folder), remedy="name a writable journal.folder") from why
        raise JournalError("holds a thousand journals of this second", where=str(folder), remedy="empty the folder")

    def event(self, now_ns: int, event: Event) -> None:
        """Record what the navigator is given."""
        self._put(f"/event/{type(event).__name__}", now_ns, event)

    def command(self, now_ns: int, command: Command) -> None:
        """Record what the navigator answered."""
        self._put(f"/command/{type(command).__name__}", now_ns, command)

    def entry(self, entry: Entry) -> None:
        """Record an event or a command that is at hand as `read_journal` gives it."""
        if entry.event is not None:
            self.event(entry.now_ns, entry.event)
        if entry.command is not None:
            self.command(entry.now_ns, entry.command)

    def notice(self, now_ns: int, notice: Notice) -> None:
        """Record what the shell itself reports; it is no part of the replay."""
        self._put(NOTICE, now_ns, notice)

    def mavlink(self, now_ns: int, data: bytes, *, outgoing: bool) -> None:
        """Record raw bytes of the link."""
        self._put(MAVLINK_OUT if outgoing else MAVLINK_IN, now_ns, data)

    def frame(self, now_ns: int, frame: FrameRef, pixels: Image) -> None:
        """Record a frame's pixels (copied here, encoded in the thread); drops it while others still wait."""
        if self._frames_waiting >= _FRAMES_QUEUED:
            self.dropped += 1
            return
        self._frames_waiting += 1
        if not self._put(FRAME, now_ns, (frame.frame_id, np.array(pixels))):
            self._frames_waiting -= 1

    def wait(self, most: int) -> None:
        """Return when at most so many records wait, and no frame: for what records faster than a flight goes by."""
        while self._thread.is_alive() and (self._queue.qsize() > most or self._frames_waiting):
            time.sleep(0.001)

    def close(self) -> None:
        """Write what waits, flush to the disk and close the file; at most `_CLOSE_S` is waited for a disk that hangs."""
        if self._thread.is_alive():
            by_s = time.monotonic() + _CLOSE_S
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=_CLOSE_S)
            self._thread.join(max(0.0, by_s - time.monotonic()))
        if not self._stream.closed:
            abandon(self._stream, None)

    def _put(self, topic: str, now_ns: int, thing: Any) -> bool:
        """Whether it waits to be written now."""
        self._sequence = (self._sequence + 1) % 2**32
        try:
            if self.problem:
                raise queue.Full
            self._queue.put_nowait((topic, now_ns, self._sequence, thing))
        except queue.Full:
            self.dropped += 1
            return False
        return True

    def _run(self) -> None:
        try:
            self._writer.start(profile="", library="visloc-companion")
            flush_at = 0.0  # at once, so that the header is on the disk
            while (item := self._next(flush_at)) is not None:
                try:
                    if item:
                        self._write(*item)
                    if time.monotonic() >= flush_at:
                        self._flush()
                        self._stay_there()
                        flush_at = time.monotonic() + _FLUSH_S
                except OSError as why:
                    if not (self._goes_on and self._written.kept_bytes and is_of_the_disk(why)):
                        raise
                    if not self._taken_again(why):
                        return
            self._finish()
        except Exception as why:  # whatever it is, the flight goes on and the operator is told
            self._end(f"journal stopped: {getattr(why, 'strerror', None) or why}")
            self._drain()

    def _taken_again(self, why: OSError) -> bool:
        """Drop what comes until the disk takes what waits; False where the flight ends before, with as much as it takes then."""
        self.problem, before = f"journal stopped: {why.strerror}", self.dropped
        self._report(self.problem)
        while True:
            if self._drain(time.monotonic() + _TRY_AGAIN_S):
                try:
                    self._finish()
                except OSError:
                    abandon(self._stream, self.path)
                return False
            with contextlib.suppress(OSError):
                self._flush()
                self.problem = ""
                self._report(f"journal goes on: {self.dropped - before} records missing")
                return True

    def _next(self, flush_at: float) -> tuple[str, int, int, Any] | tuple[()] | None:
        """The next record, nothing when it is time to flush, None at the end."""
        try:
            return self._queue.get(timeout=max(0.0, flush_at - time.monotonic()))
        except queue.Empty:
            return ()

    def _write(self, topic: str, now_ns: int, sequence: int, thing: Any) -> None:
        try:
            data = self._encoded(topic, thing)
            if not 0 <= now_ns < 2**64:
                raise JournalError(f"the time {now_ns} ns is outside of what MCAP can hold", where=topic)
            if not self._has_room(len(data) + _MESSAGE_OVERHEAD_BYTES):
                self._finish()
                raise _FullError(f"it reached journal.max_bytes = {self._max_bytes}")
            self._writer.add_message(self._channel(topic), now_ns, data, now_ns, sequence)
            self.written += 1
        except OSError:
            self.dropped += 1
            raise
        except JournalError as why:
            self.dropped += 1
            if not self._drop_told:
                self._drop_told = True
                self._report(f"journal record dropped: {why}")

    def _encoded(self, topic: str, thing: Any) -> bytes:
        try:
            return payload(topic, thing)
        except JournalError:
            raise
        except Exception as why:  # no memory for a picture, for one
            raise JournalError(fault_text(why), where=topic) from why
        finally:
            self._frames_waiting -= topic == FRAME

    def _has_room(self, n_bytes: int) -> bool:
        """Whether a record fits; ends the chunk first where it would grow too large."""
        if self._pending_bytes and self._pending_bytes + n_bytes > CHUNK_BYTES:
            self._end_chunk()
        self._pending_bytes += n_bytes
        end_bytes = _SUMMARY_BYTES + _SUMMARY_CHUNK_BYTES * (self._chunks + 1)
        return self._written.tell() + self._pending_bytes + end_bytes <= self._max_bytes

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            name = topic.rsplit("/", 1)[1]
            kind = {**EVENT_TYPES, **COMMAND_TYPES}.get(name)
            schema = json_schema(kind) if kind else {"title": name, "type": "object"}
            binary = topic in BINARY
            schema_id = 0 if binary else self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "binary" if binary else "json", schema_id)
        return self._channels[topic]

    def _end_chunk(self) -> None:
        self._writer.flush()
        self._chunks += self._pending_bytes > 0
        self._pending_bytes = 0

    def _flush(self) -> None:
        self._end_chunk()
        try:
            os.fsync(self._stream.fileno())
            if self.path is not None and not self._goes_on:
                require_there(self._stream, self.path)
        except io.UnsupportedOperation:
            return  # a stream without a file
        except OSError as why:
            if why.errno != errno.EINVAL:  # a file that cannot be synchronised, as pipes and devices
                raise

    def _stay_there(self, *, whole: bool = False) -> None:
        """Make a file anew that was removed, some of it each time (`whole`: all of it), and write on there."""
        if self.path is None or not self._goes_on:
            return
        anew = self._anew.made(self._stream, self._written.kept_bytes, whole=whole)
        if anew is not None:
            self._stream.close()
            self._stream = anew
            self._written.move_to(anew)

    def _finish(self) -> None:
        self._writer.finish()
        self._flush()
        self._stay_there(whole=True)
        self._stream.close()

    def _end(self, problem: str) -> None:
        self.problem = problem
        abandon(self._stream, self.path)
        self._report(problem)

    def _report(self, problem: str) -> None:
        if self._on_problem is not None:
            self._on_problem(problem)

    def _drain(self, by_s: float = 0.0) -> bool:
        """Drop what waits, and what comes until then (monotonic, seconds); whether it was the end."""
        with contextlib.suppress(queue.Empty):
            while (item := self._queue.get(timeout=max(0.0, by_s - time.monotonic()))) is not None:
                self.dropped += 1
                self._frames_waiting -= item[0] == FRAME
            return True
        return False


class _FullError(Exception):
    pass
