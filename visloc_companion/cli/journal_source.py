"""A recorded journal that is replayed: its events go through the navigator again, and what it commands is compared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from visloc_companion.app.journal import Entry, header_left, read_header, read_journal
from visloc_companion.app.replay import Comparison, compare, flown_config, recorded_commands, replay_entries
from visloc_companion.app.rounding import ROUNDING
from visloc_companion.app.settings import core_settings
from visloc_companion.app.versions import versions
from visloc_companion.cli.read_once import read_once
from visloc_companion.config import Config
from visloc_companion.evaluate.flight import Pace
from visloc_companion.evaluate.gate import Check
from visloc_companion.evaluate.record import FlightRecord, from_entries
from visloc_companion.evaluate.reports.report_map import MapImage
from visloc_companion.maps.pack import PackMap


@dataclass(slots=True)
class JournalSource:
    """A journal: its events go through the navigator again, and every command is compared with the recorded one."""

    path: Path
    config: Config | None
    salvage: bool
    reference: PackMap | None
    pace: Pace | None = None
    latency: Literal["arrival", "computation"] = "arrival"
    here: dict[str, str] = field(default_factory=versions)
    result: dict[str, Any] = field(default_factory=dict)

    def record(self) -> FlightRecord:
        """Replay and compare. Raises JournalError for damage, unless it is to be salvaged."""
        damages: list[str] = []
        with read_once():
            entries = list(read_journal(self.path, salvage=self.salvage, on_damage=damages.append))
        header = header_left(self.path) if self.salvage and self.config is not None else read_header(self.path)
        effective = self.config or flown_config(header, self.path)
        events = [entry for entry in entries if entry.event is not None]
        with read_once():
            replayed = replay_entries(self._paced(events), core_settings(effective))
        found = compare(recorded_commands(entries), replayed)
        flown = [*events, *(Entry(now_ns, None, command) for now_ns, command in replayed)]
        record = from_entries(sorted(flown, key=lambda entry: entry.now_ns))
        self.result = {
            "commands": self._compared(found, damaged=bool(damages)),
            "flown_with": {
                name: there for name, here in self.here.items() if (there := header.versions.get(name, "not stated")) != here
            },
            "damages": damages,
            "verdicts": record.changes(record.verdicts),
            "modes": record.changes(record.modes),
        }
        return record

    def _compared(self, found: Comparison, *, damaged: bool) -> dict[str, Any]:
        as_many = found.n_recorded == found.n_replayed
        none_left, same_length = not found.n_compared and (damaged or as_many), self.salvage or as_many
        return {
            "identical": None if none_left else found.first_difference is None and same_length,
            "n_recorded": found.n_recorded,
            "n_replayed": found.n_replayed,
            "first_difference": found.first_difference,
            "largest_difference": found.largest_difference if same_length and not none_left else None,
        }

    def _paced(self, events: list[Entry]) -> Iterable[Entry]:
        for entry in events:
            if self.pace is not None:
                self.pace(entry.now_ns)
            yield entry

    def facts(self) -> dict[str, Any]:
        """Whether the commands are the recorded ones byte for byte (None: there is none to compare) and how far their numbers
        lie apart (None where more than numbers differs), in what the flight's computer and versions were others, what was
        damaged, verdicts and modes over time."""
        return self.result

    def notes(self) -> list[str]:
        """The outcome of the comparison in words."""
        commands, words = self.result["commands"], self._outcome()
        if self.config is not None:
            words += " The configuration is not the flight's own."
        if commands["identical"] is False and self.result["flown_with"]:
            others = (f"{name} {flown} (here {self.here[name]})" for name, flown in self.result["flown_with"].items())
            words += f" It was flown with {', '.join(others)}."
        notes = [words, *(f"Damaged: {damage}." for damage in self.result["damages"])]
        if self.reference is not None:
            notes.append("The map is for the report's picture alone, the fixes are the flight's: --rerun localises frames anew.")
        return notes

    def _outcome(self) -> str:
        commands = self.result["commands"]
        n, recorded, first = commands["n_replayed"], commands["n_recorded"], commands["first_difference"]
        if commands["identical"] is None and not self.result["damages"]:
            return "The journal holds no command: nothing was flown."
        if commands["identical"] is None:
            return "Of what is left of the journal no command can be compared with the flight's."
        if commands["identical"]:
            return f"All {min(n, recorded)} commands are byte for byte those of the flight."
        if first is None:
            return f"The replay gives {n} commands, the flight gave {recorded}; those that both have are the same."
        if self._rounded:
            part = commands["largest_difference"]
            return (
                f"All {min(n, recorded)} commands are those of the flight but for rounding: numbers are {part:.1g} apart at most."
            )
        return f"The replay differs from the flight, first at command {first + 1} of {recorded}."

    @property
    def _rounded(self) -> bool:
        largest = self.result["commands"]["largest_difference"]
        return largest is not None and 0 < largest <= ROUNDING

    def checks(self) -> list[Check]:
        """With the flight's own configuration the commands must be the recorded ones, and be there to be compared: to the last
        bit where computer and versions are the flight's, too."""
        if self.config is not None:
            return []
        identical = self.result["commands"]["identical"]
        found = {True: "identical", False: "different", None: "not known, none can be compared"}[identical]
        if self._rounded:
            found = "identical but for rounding"
        passed = identical is True or (self._rounded and bool(self.result["flown_with"]))
        return [Check("commands", found, "identical to the recording", passed)]

    def map_image(self, record: FlightRecord) -> MapImage | None:
        """The pack's ortho under the tracks."""
        from visloc_companion.evaluate.map_image import map_image

        return map_image(self.reference, record) if self.reference is not None else None
