"""Lines of the log go out whole and in order, and hold nobody up."""

from __future__ import annotations

import os
import time

import structlog

from visloc_companion.app.log_lines import CAPACITY, CLOSE_S, LogLines


def test_lines_are_whole_and_in_order_when_it_is_closed() -> None:
    reader, writer = os.pipe()
    lines = LogLines(writer)
    log = structlog.WriteLogger(lines)  # type: ignore[arg-type]
    said = [f"line {n} °\ud800" for n in range(200)]
    for text in said:
        log.msg(text)
    lines.close()
    os.close(writer)
    with os.fdopen(reader, "rb") as file:
        assert file.read().decode().splitlines() == [text.replace("\ud800", "\\ud800") for text in said]
    assert lines.lost == 0


def test_what_a_full_disk_does_not_take_is_counted() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    lines = LogLines(full)
    assert lines.write("one\n") == 4
    lines.write("two\n")
    lines.close()
    os.close(full)
    assert lines.lost == 2


def test_who_stalls_holds_up_neither_a_line_nor_the_end_for_long() -> None:
    reader, writer = os.pipe()
    lines = LogLines(writer)
    begun_s = time.monotonic()
    for _ in range(CAPACITY + 100):
        lines.write("x" * 1000)
    assert time.monotonic() - begun_s < CLOSE_S
    assert lines.lost > 0  # a pipe takes 64 kB
    lines.close()
    assert time.monotonic() - begun_s < 10 * CLOSE_S
    os.close(reader)  # the thread's write fails now, and it ends
    lines._thread.join(10)
    os.close(writer)
    assert not lines._thread.is_alive()
