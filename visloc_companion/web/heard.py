"""How much the newest snapshot is worth: heard now, heard once, or never."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from visloc_companion.web.reading import number, part
from visloc_companion.web.words import span

STALE_S = 2.0
"""Older than this, what was heard is not shown as current."""
CLIENT_STALE_S = 3.0
"""The same in the browser, of the page's own server."""
State = Literal["live", "stale", "absent"]


@dataclass(frozen=True, slots=True)
class Heard:
    """The newest snapshot, when it came (seconds on the server's clock), and why there is no newer one (empty: there is)."""

    snapshot: dict[str, Any] | None = None
    at_s: float = 0.0
    problem: str = ""


def aged(snapshot: dict[str, Any], by_s: float) -> dict[str, Any]:
    """A snapshot in which every age has grown since it was made."""
    status, found = part(snapshot, "status"), snapshot.get("notices")
    notices = [_older(item, "age_s", by_s) for item in found if isinstance(item, dict)] if isinstance(found, list) else []
    older = {
        "status": _older(status, "age_of_fix_s", by_s),
        "gnss": _older(part(snapshot, "gnss"), "age_s", by_s),
        "answer": _older(part(snapshot, "answer"), "age_s", by_s),
        "notices": notices,
    }
    return _older({**snapshot, **older}, "frame_age_s", by_s)


def _older(thing: dict[str, Any], name: str, by_s: float) -> dict[str, Any]:
    age_s = number(thing.get(name))
    return thing if age_s is None else {**thing, name: age_s + by_s}


def state_of(heard: Heard, now_s: float) -> tuple[State, str]:
    """Whether what was heard is current, and what to say where it is not: `live` says nothing."""
    if heard.snapshot is None:
        return "absent", heard.problem or "Not asked yet."
    age_s = max(0.0, now_s - heard.at_s)
    if age_s > STALE_S:
        return "stale", f"{heard.problem or 'No answer.'} Last heard {span(age_s)} ago: what is shown is what was known then."
    status = part(heard.snapshot, "status")
    if not status:
        return "stale", "The daemon answers, but its navigator has stated nothing yet."
    t_ns, stated_ns = number(heard.snapshot.get("t_ns")), number(status.get("t_ns"))
    behind_s = None if t_ns is None or stated_ns is None else (t_ns - stated_ns) / 1e9
    if behind_s is None or behind_s > STALE_S:
        since = "for an unknown time" if behind_s is None else f"for {span(behind_s)}"
        return "stale", f"The daemon answers, but its navigator has stood still {since}: what is shown is what was known then."
    return "live", ""
