"""What tests of a journal that is written share."""

from __future__ import annotations

import time
from collections.abc import Callable

from visloc_companion.app.journal import JournalWriter
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.types import Tick

HEADER = JournalHeader({}, {}, "", "", 0, 0)


def until(happened: Callable[[], object]) -> None:
    """Wait for what another thread does; fails after half a minute."""
    by_s = time.monotonic() + 30
    while not happened():
        assert time.monotonic() < by_s
        time.sleep(0.01)


def record(writer: JournalWriter, times_ns: range) -> None:
    """A tick for each time."""
    for t_ns in times_ns:
        writer.event(t_ns, Tick(t_ns))
