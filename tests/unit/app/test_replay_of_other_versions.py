"""Journals that another version wrote: what cannot be replayed is said with what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from visloc_companion.app.journal import JournalHeader, JournalWriter
from visloc_companion.app.replay import journal_settings
from visloc_companion.config import Config
from visloc_companion.errors import ConfigError, JournalError

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
