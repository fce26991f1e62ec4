"""A recorded flight once more: the same navigator, fed by a for loop. Same entries and settings, same bytes out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from visloc_companion.app.journal import Entry, read_header, read_journal
from visloc_companion.app.journal_header import JournalHeader
from visloc_companion.app.rounding import largest_difference
from visloc_companion.app.serialise import to_json
from visloc_companion.app.settings import core_settings
from visloc_companion.config import Config, parse_config
from visloc_companion.core.settings import CoreSettings
from visloc_companion.errors import ConfigError, JournalError
from visloc_companion.types import Command

_SCHEMA = JournalHeader({}).schema


def replay(entries: Iterable[Entry], settings: CoreSettings) -> Iterator[tuple[Entry, list[Command]]]:
    """Every recorded event with the commands that the navigator answers now; recorded commands are passed over."""
    from visloc_companion.core.navigator import Navigator  # loads filterpy: only who flies waits

    navigator = Navigator(settings)
    for entry in entries:
        if entry.event is not None:
            yield entry, navigator.on(entry.event, entry.now_ns)


def replay_entries(entries: Iterable[Entry], settings: CoreSettings) -> list[tuple[int, Command]]:
    """The commands that the navigator answers to recorded events, with their times."""
    return [(entry.now_ns, command) for entry, commands in replay(entries, settings) for command in commands]


def recorded_commands(entries: Iterable[Entry]) -> list[tuple[int, Command]]:
    """The commands that were given in flight, with their times."""
    return [(entry.now_ns, entry.command) for entry in entries if entry.command is not None]


def journal_settings(path: Path) -> CoreSettings:
    """What the navigator of a recorded flight was told. Raises JournalError or ConfigError."""
    return core_settings(flown_config(read_header(path), path))


def flown_config(header: JournalHeader, path: Path) -> Config:
    """The configuration of a recorded flight. Raises JournalError for a journal of another schema, ConfigError for a key or a
    value that this version does not know."""
    flown_with = f"the version that recorded it ({header.versions.get('visloc-companion', 'not stated')})"
    if header.schema != _SCHEMA:
        what = f"is a journal of schema {header.schema}, and this version reads {_SCHEMA}"
        raise JournalError(what, where=str(path), remedy=f"replay it with {flown_with}")
    try:
        return parse_config(header.configuration, where=str(path))
    except ConfigError as why:
        remedy = f"it is another version's: replay it with {flown_with}, or with a configuration of this one, --config FILE"
        raise ConfigError(why.what, where=why.where, remedy=remedy) from why


def command_lines(commands: Iterable[tuple[int, Command]]) -> Iterator[str]:
    """One line a command: time in ns and JSON. Two runs are the same when these are the same bytes."""
    return (f"{now_ns} {to_json(command)}" for now_ns, command in commands)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A replay against its recording. `first_difference` is the number of the first command that differs, None if none does.

    A journal whose end was lost has fewer recorded commands than the replay gives: `n_compared` tells how far both go, and
    `largest_difference` how far their numbers lie apart there (`app.rounding`), None where anything else differs.
    """

    n_recorded: int
    n_replayed: int
    n_compared: int
    first_difference: int | None
    largest_difference: float | None


def compare(recorded: Iterable[tuple[int, Command]], replayed: Iterable[tuple[int, Command]]) -> Comparison:
    """Every command, with its time, beside the recorded one, byte for byte."""
    flown, now = list(command_lines(recorded)), list(command_lines(replayed))
    n_compared = min(len(flown), len(now))
    differences = (n for n in range(n_compared) if flown[n] != now[n])
    return Comparison(len(flown), len(now), n_compared, next(differences, None), largest_difference(flown, now))


def compare_with_recording(path: Path) -> Comparison:
    """Replay a journal and compare its commands."""
    entries = list(read_journal(path))
    return compare(recorded_commands(entries), replay_entries(entries, journal_settings(path)))
