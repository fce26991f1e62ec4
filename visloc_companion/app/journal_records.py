"""The records of a journal's file, as they lie in it."""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

from visloc_companion.app import journal_lock
from visloc_companion.app.salvage import OnDamage, Record, read_records
from visloc_companion.errors import JournalError


def records(path: Path, salvage: bool, on_damage: OnDamage | None) -> Iterator[Record]:
    """With `salvage`, damage is told to `on_damage`; without, and for what is no file that can be read, raises JournalError."""
    written = False

    def damaged(what: str) -> None:
        if not salvage:
            state, wait = ("not whole", "wait for its end, or ") if written else ("damaged", "")
            remedy = f"{wait}read what is there: visloc replay FILE --salvage"
            raise JournalError(f"is {state}: {what}", where=str(path), remedy=remedy)
        if on_damage is not None:
            on_damage(what)

    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size == 0:
                raise JournalError("is empty", where=str(path), remedy="use another journal")
            written = journal_lock.is_held(file)  # before its length is taken: what ends in between ends whole
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from read_records(data, str(path), damaged, written=written)
    except (OSError, ValueError) as why:
        raise JournalError(f"cannot be read: {why}", where=str(path), remedy="name a readable .mcap file") from why
