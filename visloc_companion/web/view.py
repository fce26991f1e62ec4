"""The snapshot as the page shows it: a pure function of what was heard, which no snapshot can break."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from visloc_companion.web import condition, navigation
from visloc_companion.web.heard import CLIENT_STALE_S, Heard, aged, state_of
from visloc_companion.web.reading import number, only_finite, part

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Origin:
    """Where snapshots come from: the daemon's socket, or a journal that is played `speed` times as fast as it was flown."""

    name: str
    speed: float | None = None

    @property
    def recording(self) -> bool:
        """Whether what is shown happened in the past."""
        return self.speed is not None


def view_of(heard: Heard, origin: Origin, now_s: float) -> dict[str, Any]:
    """What /api/status and the stream give (docs/dashboard.md); strict JSON, `now_s` on the clock of `heard.at_s`."""
    age_s = None if heard.snapshot is None else max(0.0, now_s - heard.at_s)
    snapshot = aged(heard.snapshot, age_s or 0.0) if heard.snapshot else {}
    status = part(snapshot, "status")
    state, says = state_of(heard, now_s)
    t_ns = number(snapshot.get("t_ns"), 0.0)
    view: dict[str, Any] = {
        "schema": SCHEMA,
        "source": {"name": origin.name, "recording": origin.recording, "speed": origin.speed},
        "state": state,
        "says": says,
        "heard_age_s": age_s,
        "stale_after_s": CLIENT_STALE_S,
        "t_s": None if t_ns is None else t_ns / 1e9,
        "mode": navigation.mode(status),
        "position": navigation.position(snapshot),
        "integrity": navigation.integrity(status),
        "fix": navigation.fix(snapshot),
        "gnss": navigation.gnss(snapshot),
        "injection": condition.injection(snapshot),
        "line": condition.line(snapshot),
        "health": condition.health(snapshot),
        "notices": condition.notices(snapshot),
    }
    finite: dict[str, Any] = only_finite(view)
    return finite
