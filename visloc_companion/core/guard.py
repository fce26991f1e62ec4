"""The core's own time, which never goes back, and notices that do not repeat themselves."""

from __future__ import annotations

from enum import Enum

from visloc_companion.errors import Reason
from visloc_companion.types import Event, Notice, Severity

TOLERATED_NS = 1_000_000_000
RESTART_AFTER = 20
REPEAT_NS = 10_000_000_000


class TimeCheck(Enum):
    """What to do with an event, judged by the time that came with it."""

    FINE = "fine"
    DROP = "drop"
    RESTART = "restart"


class TimeGuard:
    """Watches the shell's monotonic clock.

    Small steps back are clamped. An event far in the past is dropped; RESTART_AFTER of them in a row mean that the clock
    itself was set back (another recording, a simulator that began anew), and nothing that is remembered has a time any more.
    """

    def __init__(self) -> None:
        self.now_ns: int | None = None
        self._n_back = 0

    def check(self, now_ns: int) -> TimeCheck:
        """Judge and remember a time."""
        if self.now_ns is not None and now_ns < self.now_ns - TOLERATED_NS:
            self._n_back += 1
            return TimeCheck.RESTART if self._n_back >= RESTART_AFTER else TimeCheck.DROP
        self._n_back = 0
        self.now_ns = now_ns if self.now_ns is None else max(self.now_ns, now_ns)
        return TimeCheck.FINE


class Complaints:
    """Notices about bad input, at most one for each kind and reason in REPEAT_NS."""

    def __init__(self) -> None:
        self._last_ns: dict[tuple[str, Reason], int] = {}

    def about(self, event: Event, reason: Reason, now_ns: int, severity: Severity = Severity.WARNING) -> list[Notice]:
        """The notice that an event was not used, unless that was said just now."""
        key = (type(event).__name__, reason)
        last = self._last_ns.get(key)
        if last is not None and 0 <= now_ns - last < REPEAT_NS:
            return []
        self._last_ns[key] = now_ns
        return [Notice(severity, f"{key[0]} not used: {reason.value}", data=(("reason", reason.value),))]
