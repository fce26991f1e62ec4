"""Journals that another version wrote: what cannot be replayed is said with what to do."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from visloc_companion.app.journal import JournalHeader, JournalWriter, read_header, read_journal
from visloc_companion.app.replay import journal_settings
from visloc_companion.config import Config
from visloc_companion.errors import ConfigError, JournalError
from visloc_companion.types import Tick

OURS = JournalHeader(Config().model_dump(mode="json"), {"visloc-companion": "0.0.7"})


def written(folder: Path, header: JournalHeader) -> Path:
    journal = JournalWriter.create(folder, header, max_bytes=10_000_000)
    journal.close()
    assert journal.path is not None
    return journal.path


@pytest.mark.parametrize("schema", [0, 2])
def test_another_schema_is_not_replayed_as_if_it_were_this_one(tmp_path: Path, schema: int) -> None:
    """Its entries may mean something else; it was replayed without a word."""
    path = written(tmp_path, replace(OURS, schema=schema))
    with pytest.raises(JournalError, match=rf"is a journal of schema {schema}, .* reads 1; remedy: replay it with .*0\.0\.7"):
        journal_settings(path)
    journal_settings(written(tmp_path, OURS))


def test_a_key_that_is_no_longer_known_is_not_for_the_reader_of_a_journal_to_correct(tmp_path: Path) -> None:
    configuration = {**OURS.configuration, "gone": {"key": 1}}
    path = written(tmp_path, replace(OURS, configuration=configuration))
    with pytest.raises(ConfigError, match=r"gone: unknown key.*remedy: it is another version's: replay it with .*--config FILE"):
        journal_settings(path)


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ('{"type":"Tick","t_rx_ns":1,"newer":2}', r"Tick cannot be read: unknown fields \['newer'\]"),
        ('{"type":"Tick"}', r"Tick cannot be read: missing fields \['t_rx_ns'\]"),
        ('{"type":"Tock","t_ns":1}', "unknown type 'Tock'"),
    ],
)
def test_an_entry_of_another_version_is_told_with_file_and_record(
    tmp_path: Path, entry: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("visloc_companion.app.journal_payload.to_json", lambda _: entry)
    journal = JournalWriter.create(tmp_path, OURS, max_bytes=10_000_000)
    journal.event(1, Tick(1))
    journal.close()
    assert journal.path is not None
    with pytest.raises(JournalError, match=rf"\.mcap: record 2: {told}; remedy: read it with the version of visloc"):
        list(read_journal(journal.path))


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"extra": 1}, "unknown: extra"),
        ({"schema": "2", "extra": 1}, "unknown: extra"),
        ({"versions": ["a"]}, "of another kind: versions"),
        ({"started_unix_ns": None, "configuration": None}, "of another kind: configuration, started_unix_ns"),
    ],
)
def test_a_header_of_another_version_is_told_with_file_and_remedy(
    tmp_path: Path, changed: dict[str, Any], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("visloc_companion.app.journal_payload.asdict", lambda thing: asdict(thing) | changed)
    path = written(tmp_path, OURS)
    with pytest.raises(JournalError, match=rf"\.mcap: its header cannot be read: {told}; remedy: read it with the version"):
        read_header(path)


def test_a_header_without_what_came_later_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visloc_companion.app.journal_payload.asdict", lambda thing: {"configuration": thing.configuration})
    assert read_header(written(tmp_path, OURS)) == replace(OURS, versions={})
