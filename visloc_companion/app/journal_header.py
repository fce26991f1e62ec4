"""The first record of a journal: what flew."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from visloc_companion.errors import JournalError

OTHER_VERSION = "read it with the version of visloc that wrote it"
_OWN = ("/header", "/event/", "/command/", "/mavlink/", "/shell/Notice", "/camera/png")
"""What a journal's topics begin with."""
_KINDS = {"configuration": dict, "versions": dict, "map_manifest_sha256": str, "map_signed_by": str}


class OtherProgramsError(JournalError):
    """An MCAP file that holds nothing of a journal."""


@dataclass(frozen=True, slots=True)
class JournalHeader:
    """First record: what flew. `started_ns` (shell's clock) and `started_unix_ns` are the same instant."""

    configuration: dict[str, Any]
    versions: dict[str, str] = field(default_factory=dict)
    map_manifest_sha256: str = ""
    map_signed_by: str = ""
    started_ns: int = 0
    started_unix_ns: int = 0
    schema: int = 1


def header_of(data: Any, path: Path) -> JournalHeader:
    """The header that was parsed from the journal `path`. Raises JournalError naming what of it is not this version's; of its
    `schema`, whatever that is, the reader tells."""
    if not isinstance(data, dict):
        raise _unreadable("it is no object", path)
    names = {item.name for item in fields(JournalHeader)}
    kinds = {name: _KINDS.get(name, int) for name in names - {"schema"}}
    told = {
        "unknown": sorted(data.keys() - names),
        "missing": [] if "configuration" in data else ["configuration"],
        "of another kind": [name for name, value in data.items() if name in kinds and type(value) is not kinds[name]],
    }
    if wrong := ", ".join(f"{what}: {', '.join(found)}" for what, found in told.items() if found):
        raise _unreadable(wrong, path)
    return JournalHeader(**data)


def require_own(topics: Set[str | None], path: Path) -> None:
    """Refuse an MCAP file all of whose topics are known (None is one that is not) and none of them a journal's: robots record in
    that format, too. Raises OtherProgramsError."""
    named = sorted(topic for topic in topics if topic is not None)
    if len(named) < len(topics) or not named or any(topic.startswith(_OWN) for topic in named):
        return
    others = f" and {len(named) - 1} more" if len(named) > 1 else ""
    raise OtherProgramsError(
        f"is an MCAP file of another program: it holds the topic {named[0]}{others}",
        where=str(path),
        remedy="name a journal that visloc wrote, or the autopilot's own log (.tlog, .bin, .ulg)",
    )


def _unreadable(wrong: str, path: Path) -> JournalError:
    return JournalError(f"its header cannot be read: {wrong}", where=str(path), remedy=OTHER_VERSION)
