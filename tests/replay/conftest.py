"""Flights as their journals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.app.journal import Entry, JournalHeader, JournalWriter
from visloc_companion.config import parse_config

Recorded = Callable[[Iterable[Entry], dict[str, Any]], Path]


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    """The journal of entries that were flown with a configuration."""

    def write(entries: Iterable[Entry], configuration: dict[str, Any]) -> Path:
        header = JournalHeader(parse_config(configuration).model_dump(mode="json"))
        writer = JournalWriter.create(tmp_path, header, max_bytes=10**8)
        for entry in entries:
            writer.entry(entry)
            writer.wait(4000)
        writer.close()
        assert writer.path is not None
        return writer.path

    return write
