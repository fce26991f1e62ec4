"""What the operator would have been told in a flight that is replayed: a camera that is late, mounted or built otherwise, say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from visloc_companion.app.journal import Entry
from visloc_companion.types import Notice, Severity

_GRAVE = (Severity.WARNING, Severity.CRITICAL)
_MOST = 12
"""Sentences; what is told anew with another number counts as another."""


@dataclass(slots=True)
class Told:
    """Warnings and when each was given first, ns."""

    first_ns: dict[str, int] = field(default_factory=dict)

    def heard(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        """The same entries; what they tell is kept."""
        for entry in entries:
            notice = entry.command
            if isinstance(notice, Notice) and notice.to_operator and notice.severity in _GRAVE:
                self.first_ns.setdefault(notice.text, entry.now_ns)
            yield entry

    def sentences(self, start_ns: int) -> list[str]:
        """One for each warning, with seconds since the start; none for an empty flight."""
        words = [
            f"The operator would have been told after {(t_ns - start_ns) / 1e9:.1f} s: {text}"
            for text, t_ns in list(self.first_ns.items())[:_MOST]
        ]
        more = len(self.first_ns) - len(words)
        return [*words, *([f"And {more} more warnings."] if more else [])]
